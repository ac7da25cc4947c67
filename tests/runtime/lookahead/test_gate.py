from types import SimpleNamespace

import msgspec
import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lookahead import Alternative, LookaheadRequest, LookaheadResult, read_lookahead
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.lookahead.forecaster import Case
from phyagentos.runtime.lookahead.gate import LookaheadGate
from phyagentos.runtime.lookahead.service import RehearsalProcess

WORLD = Environment(time_s=0.4, scene="tabletop/waiter", episode="e", revision=1, sensing="truth", entities={})
SLOWER = Alternative(strategy=Strategy(speed=0.5), samples=16, succeeded=15)


class Forecasts:
    def __init__(self, answer):
        self.answer, self.asked = answer, []

    def ask(self, question, should_stop):
        self.asked.append(question)
        if isinstance(self.answer, ExecutionError):
            raise self.answer
        return self.answer


def make_result(succeeded):
    return LookaheadResult(
        samples=16, succeeded=succeeded, threshold=0.8, causes={"LOAD_LOST": 16 - succeeded}, alternatives=(SLOWER,)
    )


@pytest.fixture
def careful(build_session):
    return build_session(lookahead=LookaheadRequest(samples=16, threshold=0.8, seed=3))


@pytest.fixture
def open_gate(tmp_path):
    def open_gate(answer):
        world = SimpleNamespace(enter=lambda _: None, observe=lambda _: WORLD)
        return LookaheadGate(forecasts=Forecasts(answer), world=world, evidence=tmp_path)

    return open_gate


def never():
    return False


def test_a_session_that_asks_for_nothing_is_not_rehearsed(open_gate, build_session):
    gate = open_gate(make_result(0))

    assert gate.find_problems(build_session(), "pick_and_place", never) == ()
    assert gate._forecasts.asked == []


def test_a_low_forecast_refuses_with_cause_and_remedy_and_leaves_its_evidence(open_gate, careful, tmp_path):
    (problem,) = open_gate(make_result(5)).find_problems(careful, "pick_and_place", never)

    assert problem.code == "LOOKAHEAD_LOW"
    assert problem.found == "5 of 16 rollouts succeed (LOAD_LOST 11)"
    assert problem.hint == "15 of 16 succeed at half speed."
    assert read_lookahead(tmp_path / careful.id) == make_result(5)


def test_a_good_forecast_is_kept_for_the_bundle_of_the_session(open_gate, careful, tmp_path):
    gate = open_gate(make_result(13))

    assert gate.find_problems(careful, "pick_and_place", never) == ()
    assert not (tmp_path / careful.id).exists()
    (tmp_path / careful.id).mkdir()
    gate.file_result(tmp_path / careful.id)
    assert read_lookahead(tmp_path / careful.id).succeeded == 13


def test_the_forecast_is_asked_from_the_estimate(open_gate, careful):
    gate = open_gate(make_result(16))
    gate.find_problems(careful, "pick_and_place", never)

    (asked,) = gate._forecasts.asked
    assert asked == Case(session=careful, request=careful.lookahead, tree="pick_and_place", environment=WORLD)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(asked), type=Case) == asked


@pytest.mark.parametrize(
    ("answer", "tree", "found"),
    [
        (ExecutionError("LOOKAHEAD_FAILED", "the rehearsal process ended with code -9"), "pick", "code -9"),
        (None, "pick", "a stop was requested"),
    ],
)
def test_what_cannot_be_foreseen_does_not_start(open_gate, careful, answer, tree, found):
    (problem,) = open_gate(answer).find_problems(careful, tree, never)

    assert problem.code == "LOOKAHEAD_FAILED"
    assert found in problem.found


def test_a_rehearsal_process_that_dies_is_an_error_and_the_next_question_starts_another(careful):
    question = Case(session=careful, request=careful.lookahead, tree="pick", environment=WORLD)
    forecasts = RehearsalProcess(["-c", "raise SystemExit(3)"])

    for _ in range(2):
        with pytest.raises(ExecutionError, match="the rehearsal process ended with code"):
            forecasts.ask(question, never)


def test_a_question_that_nobody_wants_any_more_ends_the_process(careful):
    question = Case(session=careful, request=careful.lookahead, tree="pick", environment=WORLD)
    forecasts = RehearsalProcess(["-c", "input()"])

    assert forecasts.ask(question, lambda: True) is None
    assert forecasts._child is None
