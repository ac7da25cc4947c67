"""Whole missions in which a session misses: preparation, another look, budgets, refusals, and an agent that dies."""

from contextlib import closing
from dataclasses import replace

import msgspec
import pytest

from benchmarks.recovery_parts.baselines import BlindRetry, FullRestart, NoRetry, RestartingRecovery
from phyagentos.agent.judging.review import review_session
from phyagentos.agent.judging.verifier import SessionVerifier
from phyagentos.agent.memory.advisor import Advice, NoAdvice
from phyagentos.agent.mission import goal_controller
from phyagentos.errors import Problem
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.environment import Shape, ShapeKind
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.journal import Journal
from phyagentos.testing import ManualClock

from .conftest import (
    INSPECT,
    TWO,
    Play,
    add_skills,
    change,
    check_report,
    hold,
    make_table,
    make_world,
    put,
    remove,
    slip,
    succeed,
)

MORE_SKILLS = {
    "inspect": INSPECT,
    "set_aside": """
        description: Puts an object down near a point.
        tree: set_aside
        parameters: {object: {type: entity}, support: {type: entity}, to: {type: point}}
        requires: ["visible(${object})"]
        guarantees: ["at(${object}, ${to}, 0.12)"]
        needs: {actions: [joint_position], capabilities: [manipulation]}
        """,
}


@pytest.fixture
def library(library):
    return add_skills(library, MORE_SKILLS)


def make_table_world():
    world, cube = make_world(), (Shape(kind=ShapeKind.BOX, size_m=(0.02, 0.02, 0.02)),)
    entities = {n: msgspec.structs.replace(e, shapes=cube) if e.movable else e for n, e in world.entities.items()}
    return msgspec.structs.replace(world, entities={**entities, "table": make_table()})


def hide(world, name):
    return msgspec.structs.replace(change(world, name, visible=False, observed_at_s=-100.0), sensing="perceived")


def achieve_unseen(world, session):
    play = succeed(world, session)
    return replace(play, world=hide(play.world, session.parameters["object"]))


def see_again(world, session):
    return Play(world=change(world, session.parameters["object"], visible=True))


def still_unseen(world, session):
    return Play(world=world, ended=Ended.SKILL_FAILED, code="OBJECT_HIDDEN", leaf="inspect/look")


def be_blocked(world, session):
    numbers = {"rejected": {"hand|yellow_cube": 30}}
    event = TraceEvent(tick=1, time_s=1.0, path="p/plan", leaf="plan_grasp", status="FAILURE", numbers=numbers)
    return Play(world=world, ended=Ended.SKILL_FAILED, code="NO_IK", leaf="p/plan", trace=(event,))


def move_away(world, session):
    return Play(world=put(world, session.parameters["object"], tuple(session.parameters["to"])))


def test_what_was_not_seen_is_looked_at_and_the_criteria_are_judged_again(make_stage, two):
    stage = make_stage({"red": achieve_unseen, "red.r1": see_again})
    sessions = [("green", "succeeded"), ("red", "replanned"), ("red.r1", "succeeded")]
    reasons = {"red.r1": "two-7.red, on what two-7.red.r1 saw"}
    check_report(stage.pursue(two), reasons, verdict="success", sessions=sessions, replans=0)
    look = stage.runtime.ran[-1]
    assert (look.skill, look.purpose, look.parent, look.requires) == ("inspect", "inspect", "two-7.red", ())
    assert look.priority > stage.runtime.ran[0].priority


def lose_runner(world, session):
    return Play(world=hold(world, session.parameters["object"]), ended=Ended.RUNNER_LOST, code="RUNNER_LOST")


def test_what_was_interrupted_goes_on_before_another_session_can_let_fall_what_the_hand_holds(make_stage, two):
    stage = make_stage({"green": lose_runner})
    assert stage.pursue(two).verdict == "success"
    first, again, other = stage.runtime.ran
    assert (again.parent, again.purpose, again.skill) == (first.id, "", "place")
    assert again.priority > other.priority == first.priority


def test_what_slips_out_before_the_remainder_can_begin_is_fetched_again(make_stage, two):
    stage = make_stage({"green": lose_runner})

    class Jolt:
        def on_change(self, goal, ledger):
            if any(status.contract.skill == "place" for status in ledger.iter_pending()):
                stage.runtime.world = hold(stage.runtime.world)
            stage.runtime.on_change(goal, ledger)

    report = stage.make_mission(observers=[Jolt()]).run(two, seed=7)
    assert report.verdict == "success"
    green = [session for session in report.sessions if session.node == "green"]
    assert [session.state for session in green] == ["replanned", "rejected", "succeeded"]
    assert [session.skill for session in stage.runtime.ran] == ["pick_and_place"] * 3


@pytest.mark.parametrize(("pushed_m", "verdict"), [(0.1, "failure"), (0.0, "success")])
def test_what_a_session_could_not_see_of_its_hold_condition_is_asked_of_its_replan(
    make_stage, write_graph, pushed_m, verdict
):
    held = "not moved(bottle)"
    unseen = Criterion(text=held, kind="hold", truth=Truth.UNKNOWN, because="bottle was not visible")

    def push_unseen(world, session):
        x, y, z = world.entities["bottle"].pose.position_m
        world = put(world, "bottle", (x, y + pushed_m, z))
        return Play(world=world, ended=Ended.SKILL_FAILED, code="GRASP_MISSED", hold_truth={held: unseen})

    after = "after: [green]"
    graph = write_graph(TWO.replace("BUDGET", "").replace(after, f'{after}\n        hold: ["{held}"]'))
    stage = make_stage({"red": push_unseen})
    report = stage.pursue(graph)
    assert report.verdict == verdict
    child = next(session for session in report.sessions if session.id == "two-7.red.r1")
    carried = [(each.text, each.truth) for each in child.criteria if each.kind == "constraint"]
    assert carried == [(held, "false" if pushed_m else "true")]
    sessions = read_ledger(stage.workspace.root).sessions
    with closing(Journal(stage.workspace.root, side=Side.AGENT, by="review", clock=ManualClock(9.0))) as journal:
        lineage = [sessions["two-7.red"]]
        again = review_session(stage.workspace, journal, sessions[child.id], SessionVerifier(), lineage)
    assert [(each.text, each.truth) for each in again.criteria if each.kind == "constraint"] == carried


def achieve_and_hide_green(world, session):
    play = succeed(world, session)
    return replace(play, world=hide(play.world, "green_cube"))


def test_what_the_goal_asks_and_the_last_look_does_not_show_is_looked_at_before_the_goal_is_judged(make_stage, two):
    stage = make_stage({"red": achieve_and_hide_green, "green.r1": see_again})
    sessions = [(id, "succeeded") for id in ("green", "red", "green.r1")]
    check_report(stage.pursue(two), verdict="success", sessions=sessions, replans=0)
    look = stage.runtime.ran[-1]
    assert (look.skill, look.purpose, look.parent) == ("inspect", "inspect", "two-7.green")


def let_fall(world, session):
    return Play(world=hold(world), ended=Ended.SKILL_FAILED, code="GRASP_LOST", leaf="place/verify_grasp")


PICK_AND_PLACE = ("pick_and_place", "")
LOOK, CLEAR = ("inspect", "inspect"), ("set_aside", "clear")
GREEN = ("green", "succeeded")


@pytest.mark.parametrize(
    ("stage", "expected", "ran"),
    [
        pytest.param(
            {"script": {"red": achieve_unseen, "red.r1": still_unseen, "red.r2": still_unseen}},
            {
                "verdict": "failure",
                "sessions": [GREEN, ("red", "replanned"), ("red.r1", "replanned"), ("red.r2", "failed")],
                "reasons": {"red.r2": "After 2 looks: "},
            },
            [PICK_AND_PLACE, PICK_AND_PLACE, LOOK, LOOK],
            id="what stays unseen is looked at twice and then its cause is named",
        ),
        pytest.param(
            {"script": {"red": achieve_and_hide_green, "green.r1": still_unseen, "green.r2": still_unseen}},
            {"verdict": "failure", "causes": {"green.r1": "EVIDENCE_MISSING", "green.r2": "OBJECT_GONE"}},
            [PICK_AND_PLACE, PICK_AND_PLACE, LOOK, LOOK],
            id="what the goal asks and two looks do not show ends it with the cause",
        ),
        pytest.param(
            {"script": {"red": be_blocked, "red.r1": move_away}, "world": make_table_world()},
            {"verdict": "success", "replans": 1},
            [PICK_AND_PLACE, PICK_AND_PLACE, CLEAR, PICK_AND_PLACE],
            id="what is in the way is cleared and the objective is pursued again",
        ),
        pytest.param(
            {
                "script": {
                    "red": be_blocked,
                    "red.r1": lambda world, session: Play(world=world, ended=Ended.STALLED),
                    "red.r2": move_away,
                },
                "world": make_table_world(),
            },
            {
                "verdict": "success",
                "sessions": [
                    GREEN,
                    ("red", "replanned"),
                    ("red.r1", "replanned"),
                    ("red.r2", "succeeded"),
                    ("red.r3", "succeeded"),
                ],
            },
            [PICK_AND_PLACE, PICK_AND_PLACE, CLEAR, CLEAR, PICK_AND_PLACE],
            id="a preparation that fails leads to another way and not to the end",
        ),
        pytest.param(
            {"refuse": {"red": Problem(code="LOOKAHEAD_LOW", address="look-ahead")}},
            {"sessions": [GREEN, ("red", "rejected")]},
            [PICK_AND_PLACE],
            id="a session that look-ahead refused without saying what is better blocks its node",
        ),
    ],
)
def test_a_session_that_missed_is_followed_by_what_helps(make_stage, two, stage, expected, ran):
    stage = make_stage(**stage)
    check_report(stage.pursue(two), **expected)
    assert [(session.skill, session.purpose) for session in stage.runtime.ran] == ran


def test_what_was_met_in_the_way_is_told(make_stage, two):
    stage = make_stage({"red": be_blocked, "red.r1": move_away}, world=make_table_world())
    stage.pursue(two)
    (replan, *_) = stage.make_mission().ledger.goals["two-7"].nodes["red"].replans
    assert "the planner met yellow_cube in the way" in replan.reason


def test_a_remainder_that_loses_the_object_gives_the_node_back_to_its_own_skill(make_stage, two):
    stage = make_stage({"green": lose_runner, "green.r1": let_fall})
    assert stage.pursue(two).verdict == "success"
    assert [session.skill for session in stage.runtime.ran[:3]] == ["pick_and_place", "place", "pick_and_place"]
    assert "holding(target, green_cube)" not in stage.runtime.ran[2].requires


@pytest.mark.parametrize("is_known", [True, False], ids=["hidden", "never_seen"])
def test_what_preflight_does_not_see_is_looked_at_and_then_tried_again(make_stage, two, is_known):
    start = hide(make_world(), "red_cube")
    begin = start if is_known else msgspec.structs.replace(remove(start, "red_cube"), never_seen=("red_cube",))

    def find(world, session):
        entities = {**world.entities, "red_cube": start.entities["red_cube"]}
        known = msgspec.structs.replace(world, entities=entities, never_seen=())
        return Play(world=change(known, "red_cube", visible=True))

    stage = make_stage({"red.r1": find}, world=begin)
    assert stage.pursue(two).verdict == "success"
    assert [(s.id, s.purpose) for s in stage.runtime.ran if s.node == "red"] == [
        ("two-7.red.r1", "inspect"),
        ("two-7.red.r2", ""),
    ]
    tried_again = stage.make_mission().ledger.goals["two-7"].nodes["red"].replans[-1]
    assert "two-7.red.r1 has prepared it" in tried_again.reason  # the node was not done by the look


@pytest.mark.parametrize(("code", "looks"), [("NOT_GRASPABLE", False), ("TOO_WIDE", False), ("NO_FREE_SITE", True)])
def test_nobody_looks_for_an_object_that_cannot_be_carried(make_stage, two, code, looks):
    stage = make_stage(world=hide(make_world(), "red_cube"), refuse={"red": Problem(code=code, address="dry run")})
    assert any(session.skill == "inspect" for session in stage.pursue(two).sessions) == looks


def test_what_the_goal_asks_of_an_object_that_was_never_perceived_stays_unknown_and_says_so(make_stage, write_graph):
    graph = write_graph(TWO.replace("BUDGET", "").replace("accept: [", 'accept: ["upright(bottle)", '))
    refused = Problem(code="OBJECT_GONE", address="parameters.object", found="bottle was never perceived")
    stage = make_stage(world=remove(make_world(sensing="perceived"), "bottle"), refuse={"red.r1": refused})
    nodes, sessions = {"green": "done", "red": "done"}, [GREEN, ("red", "succeeded"), ("red.r1", "rejected")]
    reasons = {"": "upright(bottle) is unknown"}
    check_report(stage.pursue(graph), reasons, verdict="failure", nodes=nodes, sessions=sessions)


def test_an_agent_that_died_while_a_way_was_cleared_comes_to_the_same_end(make_stage, two):
    stage = make_stage({"red": be_blocked, "red.r1": move_away}, world=make_table_world())

    class Killer:
        def on_change(self, goal, ledger):
            if any(status.contract.purpose for status in ledger.sessions.values()):
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stage.make_mission(observers=[stage.runtime, Killer()]).run(two, seed=7)
    report = stage.pursue(two)
    assert report.verdict == "success"
    assert [session.id for session in report.sessions if session.node == "red"] == [
        "two-7.red",
        "two-7.red.r1",
        "two-7.red.r2",
    ]


def test_nothing_is_submitted_beyond_the_budget_of_the_goal(make_stage, write_graph):
    graph = write_graph(TWO.replace("BUDGET", "budget: {sessions: 2}"))
    paid = "BUDGET: 1 sessions are left, it takes 1 more and 1 for nodes not yet begun"
    report = make_stage({"green": slip}).pursue(graph)
    check_report(report, {"green": paid}, verdict="failure", sessions=[("green", "failed")])


def test_no_session_begins_once_the_simulated_time_is_spent(make_stage, write_graph):
    report = make_stage().pursue(write_graph(TWO.replace("BUDGET", "budget: {sim_time_s: 5.0}")))
    nodes = {"green": "done", "red": "blocked"}
    check_report(report, {"": "BUDGET: the simulated time"}, verdict="failure", nodes=nodes)


def test_a_session_may_take_no_more_than_what_is_left_of_the_simulated_time(make_stage, write_graph):
    stage = make_stage()
    report = stage.pursue(write_graph(TWO.replace("BUDGET", "budget: {sim_time_s: 14.0}")))
    assert report.verdict == "success"
    assert [session.execution_s for session in stage.runtime.ran] == [14.0, 4.0]
    assert [session.limits.timeout_s for session in stage.runtime.ran] == [60.0, 60.0]
    assert stage.runtime.ran[1].explain_time() == "BUDGET: the goal's budget leaves 4 s of simulated time"


def test_sessions_begin_side_by_side_only_while_each_has_its_whole_time(make_stage, write_graph):
    stage, submitted = make_stage(), []

    class Watcher:
        def on_change(self, goal, ledger):
            submitted.append(sum(status.execution is None for status in ledger.sessions.values()))

    graph = TWO.replace("after: [green]", "after: []").replace("BUDGET", "budget: {sim_time_s: 100.0}")
    mission = stage.make_mission(observers=[Watcher(), stage.runtime])
    assert mission.run(write_graph(graph), seed=7).verdict == "success"
    assert max(submitted) == 1
    assert [session.execution_s for session in stage.runtime.ran] == [60.0, 60.0]


@pytest.mark.parametrize(
    ("policy", "verdict", "ran"),
    [
        (NoRetry(), "failure", ["green", "red"]),
        (BlindRetry(), "success", ["green", "red", "red.r1"]),
        (FullRestart(), "success", ["green", "red", "green.r1", "red.r1"]),
    ],
)
def test_other_policies_run_in_the_same_mission_loop(make_stage, two, policy, verdict, ran, monkeypatch):
    monkeypatch.setattr(goal_controller, "Recovery", RestartingRecovery)
    stage = make_stage({"red": slip})
    report = stage.make_mission(policy=policy).run(two, seed=7)
    assert report.verdict == verdict
    assert [session.id.removeprefix("two-7.") for session in stage.runtime.ran] == ran
    assert all(session.strategy == DEFAULT_STRATEGY for session in stage.runtime.ran)


def test_advice_of_memory_is_in_the_contract_and_told_with_its_source(make_stage, two):
    class Memory(NoAdvice):
        def advise(self, session):
            if session.node != "red":
                return Advice()
            return Advice(strategy=Strategy(speed=0.25), reasons=("lesson-3: it slips",), sources=("lesson-3",))

    stage = make_stage()
    stage.make_mission(advisor=Memory()).run(two, seed=7)
    green, red = stage.runtime.ran
    assert (green.strategy, green.advised_by) == (DEFAULT_STRATEGY, ())
    assert (red.strategy, red.advice, red.advised_by) == (Strategy(speed=0.25), ("lesson-3: it slips",), ("lesson-3",))
