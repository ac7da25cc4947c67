"""What the agent makes of a look-ahead: which way a refused session's child takes, and that none is given up."""

from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import pytest

from phyagentos.agent.repair.foreseen import revise_refused
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.evidence import write_json
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, Alternative, LookaheadResult
from phyagentos.protocol.sessions.session import Session, SessionStatus
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.testing import make_contract

from .conftest import ScriptedRuntime, make_rejection

GRAPH = """
    goal: careful
    objective: The red cube into its tray.
    scene: table
    targets: {arm: panda}
    defaults: {max_replans: 0, lookahead: {samples: 10, threshold: 0.8}}
    sessions:
      red:
        skill: pick_and_place
        target: arm
        with: {object: red_cube, destination: red_tray}
"""


def make_refused(attempt: int = 0) -> SessionStatus:
    contract = make_contract(id="g.n", node="n", attempt=attempt)
    return SessionStatus(contract=contract, state="rejected", reason="g.n: LOOKAHEAD_LOW: found 4 of 10")


def make_result(*alternatives: Alternative, succeeded: int = 4) -> LookaheadResult:
    causes = {"GRASP_LOST": 10 - succeeded}
    return LookaheadResult(samples=10, succeeded=succeeded, threshold=0.8, causes=causes, alternatives=alternatives)


SLOWER = Alternative(strategy=Strategy(speed=0.5), samples=10, succeeded=9)
SIDEWAYS = Alternative(strategy=Strategy(avoid_grasps=("yaw+000",)), samples=10, succeeded=6)
HOPELESS = Alternative(strategy=Strategy(speed=0.25), samples=1, succeeded=0)


def test_the_best_way_that_was_rehearsed_is_taken_and_looked_ahead_again(tmp_path):
    write_json(tmp_path / LOOKAHEAD, make_result(SIDEWAYS, SLOWER))

    advice = revise_refused(make_refused(), tmp_path)

    assert advice is not None
    assert advice.strategy == Strategy(speed=0.5)
    assert advice.threshold is None
    assert "4 of 10 rollouts succeed" in advice.reasons[0]
    assert "at half speed it is 9 of 10" in advice.reasons[0]


def test_where_no_way_is_likely_enough_the_best_is_tried_all_the_same(tmp_path):
    write_json(tmp_path / LOOKAHEAD, make_result(SIDEWAYS, HOPELESS))

    advice = revise_refused(make_refused(), tmp_path)

    assert advice is not None
    assert (advice.strategy, advice.threshold) == (Strategy(avoid_grasps=("yaw+000",)), 0.0)


def test_where_no_other_way_is_better_the_own_one_is_tried(tmp_path):
    write_json(tmp_path / LOOKAHEAD, make_result(HOPELESS))

    advice = revise_refused(make_refused(), tmp_path)

    assert advice is not None
    assert (advice.strategy, advice.threshold) == (DEFAULT_STRATEGY, 0.0)
    assert "none of 1 alternative is better" in advice.reasons[0]


def test_a_child_that_is_refused_too_is_not_refused_again(tmp_path):
    write_json(tmp_path / LOOKAHEAD, make_result(SLOWER))

    advice = revise_refused(make_refused(attempt=1), tmp_path)

    assert advice is not None
    assert (advice.strategy, advice.threshold) == (Strategy(speed=0.5), 0.0)


@pytest.mark.parametrize("text", [None, b"{not json"])
def test_without_a_readable_result_there_is_nothing_to_go_by(tmp_path, text):
    if text is not None:
        (tmp_path / LOOKAHEAD).write_bytes(text)

    assert revise_refused(make_refused(), tmp_path) is None


@dataclass
class Foreseeing:
    """Refuses by the results that it is given, one after the other; 0 as the threshold lets everything through."""

    runtime: ScriptedRuntime
    results: list[LookaheadResult]
    seen: list[Session] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._run: Callable[[Session], None] = self.runtime._run
        self.runtime._run = self.decide

    def decide(self, session: Session) -> None:
        self.seen.append(session)
        if session.lookahead is None or session.lookahead.threshold == 0.0 or not self.results:
            self._run(session)
            return
        result = self.results.pop(0)
        folder = self.runtime._workspace.evidence_of(session.id)
        folder.mkdir(parents=True)
        write_json(folder / LOOKAHEAD, result)
        found = f"{result.succeeded} of {result.samples}"
        low = Problem(code="LOOKAHEAD_LOW", address=session.id, found=found)
        self.runtime._journal.commit([make_rejection(session, low)])


def test_a_goal_whose_session_is_refused_is_met_by_its_child_and_no_replan_is_spent(make_stage, write_graph):
    stage = make_stage()
    foreseeing = Foreseeing(stage.runtime, [make_result(SLOWER), make_result(SLOWER)])

    report = stage.pursue(write_graph(GRAPH))

    first, child, last = foreseeing.seen
    assert report.verdict == "success", report
    assert report.first_attempt_success == {"red": True}
    assert [each.lookahead.threshold for each in (first, child, last)] == [0.8, 0.8, 0.0]
    assert [each.strategy for each in (first, child, last)] == [
        DEFAULT_STRATEGY,
        Strategy(speed=0.5),
        Strategy(speed=0.5),
    ]
    assert len({each.lookahead.seed for each in (first, child, last)}) == 3
    assert [each.id for each in stage.runtime.ran] == [last.id]


def test_a_node_may_do_without_look_ahead(make_stage, write_graph):
    stage = make_stage()

    stage.pursue(write_graph(GRAPH + "        lookahead: false\n"))

    assert [each.lookahead for each in stage.runtime.ran] == [None]


def test_a_result_is_the_same_after_a_journey_through_a_file():
    result = make_result(SLOWER, SIDEWAYS)

    assert msgspec.json.decode(msgspec.json.encode(result), type=LookaheadResult) == result
    assert result.is_low
    assert result.likely_cause == "GRASP_LOST"
