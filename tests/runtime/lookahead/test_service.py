"""The forecasters of a session: who is asked, who decides, and what becomes of one that fails or is distrusted."""

import re
from types import SimpleNamespace

import pytest

from phyagentos.agent.goals.spec import LookaheadSpec
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.sessions.calibration import TrackRecord
from phyagentos.protocol.sessions.forecasters import find_forecaster
from phyagentos.protocol.sessions.lookahead import Forecast, LookaheadRequest
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.lookahead.forecaster import Case
from phyagentos.runtime.lookahead.gate import LookaheadGate
from phyagentos.runtime.lookahead.service import ForecastService

WORLD = Environment(time_s=0.4, scene="s", episode="e", revision=1, sensing="truth", entities={})
BAD = TrackRecord(cases=31, brier=0.4, base_brier=0.2)


class Oracle:
    def __init__(self, name, chance=0.75, causes=None, error=None):
        self.name, self.error, self.asked = name, error, 0
        self.answer = Forecast(samples=4, succeeded=4 * chance, causes=causes or {"GRASP_LOST": 4 * (1 - chance)})

    def forecast(self, case):
        self.asked += 1
        if self.error is not None:
            raise self.error
        return self.answer


@pytest.fixture
def make_case(build_session):
    def make(*names, **more):
        request = LookaheadRequest(threshold=0.7, forecasters=names, **more)
        return Case(session=build_session(lookahead=request), request=request, tree="t", environment=WORLD)

    return make


def serve(*oracles):
    return ForecastService({each.name.partition("/")[0]: each for each in oracles}.__getitem__, SystemClock())


def test_the_first_decides_and_the_others_stand_beside_it(make_case):
    result = serve(Oracle("a/1"), Oracle("b/2", 0.25)).forecast(make_case("b", "a"))

    assert (result.forecaster, result.share, result.is_low) == ("b/2", 0.25, True)
    assert [(each.forecaster, each.share) for each in result.others] == [("a/1", 0.75)]
    assert [each.forecaster for each in result.forecasts] == ["b/2", "a/1"]


@pytest.mark.parametrize("error", [ExecutionError("LOOKAHEAD_FAILED", "no tree"), ZeroDivisionError("foreign")])
def test_one_that_fails_is_passed_over_with_a_note(make_case, error):
    result = serve(Oracle("a/1", error=error), Oracle("b/1")).forecast(make_case("a", "b"))

    assert result.forecaster == "b/1"
    assert [str(error) in note for note in result.notes] == [True]


def test_where_all_fail_there_is_no_forecast(make_case):
    with pytest.raises(ExecutionError, match="LOOKAHEAD_FAILED: a/1: ZeroDivisionError: foreign"):
        serve(Oracle("a/1", error=ZeroDivisionError("foreign"))).forecast(make_case("a"))


@pytest.mark.parametrize(
    "answer",
    [
        "likely",
        Forecast(samples=0, succeeded=0),
        Forecast(samples=4, succeeded=5, causes={"GRASP_LOST": -1}),
        Forecast(samples=4, succeeded=3),
        Forecast(samples=4, succeeded=float("nan"), causes={"GRASP_LOST": 1}),
    ],
)
def test_an_answer_that_is_no_distribution_is_none(make_case, answer):
    oracle = Oracle("a/1")
    oracle.answer = answer
    with pytest.raises(ExecutionError, match="a/1 answered with no distribution"):
        serve(oracle).forecast(make_case("a"))


def test_one_that_is_worse_than_the_base_rate_is_not_asked_and_that_is_recorded(make_case):
    bad, good = Oracle("bad/1", 0.0), Oracle("good/1")
    result = serve(bad, good).forecast(make_case("bad", "good", distrusted={"bad/1": BAD}))

    assert (bad.asked, good.asked) == (0, 1)
    assert (result.forecaster, result.withheld) == ("good/1", {"bad/1": BAD})


def test_where_all_are_distrusted_the_session_starts_and_the_evidence_shows_why(make_case, tmp_path):
    bad = Oracle("bad/1", 0.0)
    case = make_case("bad", distrusted={"bad/1": BAD})

    forecasts = SimpleNamespace(ask=lambda question, _: serve(bad).forecast(question))
    world = SimpleNamespace(enter=lambda _: None, observe=lambda _: WORLD)
    gate = LookaheadGate(forecasts=forecasts, world=world, evidence=tmp_path)
    assert gate.find_problems(case.session, "t", lambda: False) == ()
    gate.file_result(tmp_path / "g", new=True)
    assert bad.asked == 0
    assert b'"bad/1": {\n      "cases": 31' in (tmp_path / "g" / "lookahead.json").read_bytes()


def test_another_version_of_a_distrusted_forecaster_is_asked_again(make_case):
    assert serve(Oracle("bad/2")).forecast(make_case("bad", distrusted={"bad/1": BAD})).forecaster == "bad/2"


def test_a_forecaster_that_is_not_installed_is_named_with_those_that_are():
    with pytest.raises(
        DefinitionError, match=r"UNKNOWN_NAME \(forecaster\): found 'rollout'.*Did you mean 'rollouts'\?"
    ):
        find_forecaster("rollout")


def test_the_kit_of_rollouts_is_found_on_the_path_and_its_absence_names_the_command(monkeypatch):
    assert find_forecaster("rollouts").module == "rollout_forecaster.forecaster"

    monkeypatch.setattr("phyagentos.protocol.sessions.forecasters.find_spec", lambda _: None)
    with pytest.raises(
        DefinitionError, match=r"UNKNOWN_NAME \(forecaster\): found 'rollouts'.* pip install .*/kits/rollouts"
    ):
        find_forecaster("rollouts")
    with pytest.raises(ValueError, match="unsound") as refused:
        LookaheadSpec()
    assert re.search("pip install .*/kits/rollouts", refused.value.errors()[0]["ctx"]["problem"].hint)
