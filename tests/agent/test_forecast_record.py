"""What forecasts were worth decides who is asked: a forecaster that does worse than the base rate is not."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.evidence import write_json
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, ROLLOUTS, Forecast, LookaheadResult, read_lookahead
from phyagentos.protocol.sessions.session import Ended
from phyagentos.store.forecast_record import collect_scored

from .conftest import Play, succeed

GRAPH = """
    goal: g
    objective: The cubes into their trays.
    scene: table
    targets: {arm: panda}
    defaults: {max_replans: 0, lookahead: {threshold: 0.0}}
    sessions:
      red: {skill: pick_and_place, target: arm, with: {object: red_cube, destination: red_tray}}
      green: {skill: pick_and_place, target: arm, with: {object: green_cube, destination: green_tray}}
      blue: {skill: pick_and_place, target: arm, with: {object: blue_cube, destination: blue_tray}}
"""
CONTRACT = """
version: 1
world_mode: lockstep
control_period_s: 0.02
physics_step_s: 0.002
command_representation: joint_position_velocity
sampling_hz: 10
forecasting: {least_cases: 6}
"""
GOOD = Forecast(samples=10, succeeded=9, causes={"GRASP_LOST": 1})
BAD = Forecast(forecaster="bad/1", samples=10, succeeded=1, causes={"GRASP_LOST": 9})


@pytest.fixture
def stage(make_stage, monkeypatch):
    """Every session has two forecasts; all sessions succeed but `blue`, which fails in the second goal."""
    stage = make_stage(
        {"blue": lambda world, session: lose(world) if session.goal == "g-2" else succeed(world, session)}
    )
    stage.workspace.runtime_contract.write_text(CONTRACT)
    leave = stage.runtime._leave_bundle

    def leave_forecasts(session, before, play):
        leave(session, before, play)
        result = LookaheadResult(threshold=0.0, samples=10, succeeded=9, causes=GOOD.causes, others=(BAD,))
        write_json(stage.workspace.evidence_of(session.id) / LOOKAHEAD, result)

    monkeypatch.setattr(stage.runtime, "_leave_bundle", leave_forecasts)
    return stage


def lose(world):
    return Play(world=world, ended=Ended.SKILL_FAILED)


def pursue(stage, graph, seeds):
    for seed in seeds:
        stage.runtime.world = stage.start
        stage.pursue(graph, seed=seed)


@pytest.fixture
def graph(stage, write_graph):
    stage.start = stage.runtime.world
    return write_graph(GRAPH)


def test_a_forecaster_that_is_worse_than_the_base_rate_is_not_asked_any_more(stage, graph):
    pursue(stage, graph, (1, 2, 3))

    asked = {session.id: session.lookahead.distrusted for session in stage.runtime.ran}
    assert [asked[f"g-{seed}.red"] for seed in (1, 2)] == [{}, {}], "three cases are not enough"
    assert list(asked["g-3.red"]) == ["bad/1"]
    # five of six succeeded: 0.1 was foreseen for each, and by the base rate 5/7, or 6/7 for the one that failed
    record = asked["g-3.red"]["bad/1"]
    assert record.brier == pytest.approx((5 * 0.9**2 + 0.1**2) / 6)
    assert record.base_brier == pytest.approx((5 * (2 / 7) ** 2 + (6 / 7) ** 2) / 6)
    assert asked["g-3.blue"] == asked["g-3.red"], "within a goal all sessions are compiled from one record"


def test_a_damaged_forecast_counts_for_nothing(stage, graph):
    pursue(stage, graph, (1,))
    (stage.workspace.evidence_of("g-1.red") / LOOKAHEAD).write_text("{")

    assert {name: len(found) for name, found in collect_scored(stage.workspace).items()} == {ROLLOUTS: 2, "bad/1": 2}


def test_a_result_that_was_written_before_there_were_others_is_one_of_rollouts(tmp_path):
    before = {"samples": 8, "succeeded": 2, "causes": {"LOAD_LOST": 6}, "threshold": 0.8, "cost_ms": 2.0, "notes": []}
    write_json(tmp_path / LOOKAHEAD, before | {"alternatives": [{"samples": 1, "succeeded": 1, "strategy": {}}]})

    result = read_lookahead(tmp_path)
    assert (result.forecaster, result.share, result.is_low, result.others) == (ROLLOUTS, 0.25, True, ())
    assert result.alternatives[0].share == 1.0


def test_a_goal_that_names_an_unknown_forecaster_is_refused_at_its_place(stage, write_graph):
    text = GRAPH.replace("threshold: 0.0", "forecasters: [rollouts, lerned]")
    with pytest.raises(
        DefinitionError, match=r"graph.yaml:5:.*UNKNOWN_NAME \(forecaster\): found 'lerned'; expected .*rollouts"
    ):
        stage.pursue(write_graph(text))
