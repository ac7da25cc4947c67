"""Whole missions over the journal, with a runtime that moves a synthetic world."""

from dataclasses import replace

import pytest

from phyagentos.agent.mission.mission import SYNC_AFTER_S, WAIT_S
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.world.environment import Pose
from phyagentos.store.admission import Entry
from phyagentos.store.journal import Journal

from .conftest import (
    SKILLS,
    TIDY,
    Play,
    add_skills,
    change,
    check_report,
    get_order,
    hold,
    make_world,
    put,
    remove,
    slip,
    succeed,
)

UNFIT = Problem(code="NOT_OFFERED", address="joint_torque")


def test_a_mission_in_which_all_goes_well_ends_in_success(make_stage, tidy):
    report = make_stage().pursue(tidy)
    sessions = [("red", "succeeded"), ("green", "succeeded")]
    check_report(report, verdict="success", exit_code=0, sessions=sessions)
    assert (report.goal, report.first_attempt_success) == ("tidy-7", {"red": True, "green": True})
    assert [criterion.truth for criterion in report.criteria] == ["true"] * 3  # and upright(bottle), the constraint


def test_a_lost_grasp_is_replanned_into_a_slower_child_and_the_parent_keeps_its_verdict(make_stage, tidy):
    stage = make_stage({"red": slip})
    report = stage.pursue(tidy)
    sessions = [("red", "replanned"), ("green", "succeeded"), ("red.r1", "succeeded")]
    check_report(report, {"red": "verify_grasp"}, verdict="success", sessions=sessions, replans=1)
    child = stage.runtime.ran[2]
    assert (child.parent, child.attempt, child.strategy) == ("tidy-7.red", 1, Strategy(speed=0.5))
    assert child.seed != stage.runtime.ran[0].seed
    assert report.sessions[0].cause == "GRASP_LOST"
    assert report.first_attempt_success == {"red": False, "green": True}


def lose(world, session):
    return Play(world=remove(world, "red_cube"), ended=Ended.SKILL_FAILED, code="GRASP_MISSED", leaf="pick/verify")


def fail_but_achieve(world, session):
    play = succeed(world, session)
    return Play(world=play.world, ended=Ended.STALLED, code="STALLED", leaf="pick_and_place/retreat")


def take_green(world, session):
    play = succeed(world, session)
    return replace(play, world=remove(play.world, "green_cube"))


def undo_red(world, session):
    play = succeed(world, session)
    return replace(play, world=put(play.world, "red_cube", (0.4, 0.3, 0.02)))


def knock_over(world, session):
    fallen = Pose((0.8, 0, 0.03), (0.7071068, 0.7071068, 0, 0))
    return Play(world=change(succeed(world, session).world, "bottle", pose=fallen))


def drop(world, session):
    lost = hold(put(world, "red_cube", (0.5, 0.1, 0.02)))
    return Play(world=lost, ended=Ended.SKILL_FAILED, code="GRASP_LOST", leaf="place/verify_grasp")


def forget(world, session):
    """Succeeds without the output that another node needs."""
    return Play(world=succeed(world, session).world)


CHAIN = """
    goal: chain
    objective: Red, then blue beside it, then two more.
    scene: table
    sessions:
      red:
        skill: {guarantees: "inside(red_cube, red_tray)"}
      beside:
        skill: pick_and_place
        with: {object: blue_cube, destination: red_tray, near: "${red.outputs.place_site}"}
        accept: ["near(blue_cube, red_cube, 0.12)"]
      each:
        foreach: {cube: [green_cube, yellow_cube]}
        after: [beside]
        skill: pick_and_place
        with: {object: "${cube}", destination: green_tray}
    accept: ["count(inside(*, green_tray)) >= 2"]
    """
TWO_STEPS = """
    goal: two_steps
    objective: Pick, then place.
    scene: table
    sessions:
      pick:
        skill: pick
        with: {object: red_cube}
      place:
        after: [pick]
        skill: place
        with: {object: red_cube, destination: red_tray}
    accept: ["inside(red_cube, red_tray)"]
    """
OTHER_END = TIDY.replace('"inside(green_cube, green_tray)"]', '"inside(blue_cube, blue_tray)"]')
ALL_BLOCKED = dict.fromkeys(("red", "beside", "each-green_cube", "each-yellow_cube"), "blocked")
SUCCESS, FAILURE = {"verdict": "success", "exit_code": 0}, {"verdict": "failure", "exit_code": 1}


@pytest.mark.parametrize(
    ("graph", "stage", "expected"),
    [
        pytest.param(
            TIDY,
            {"script": {"red": slip, "red.r1": slip, "red.r2": slip}},
            FAILURE
            | {"nodes": {"red": "blocked", "green": "done"}, "reasons": {"red.r2": "The budget of 2 replans is spent"}},
            id="a spent budget ends in failure and the other nodes are done",
        ),
        pytest.param(
            TIDY,
            {"script": {"red": lose}},
            FAILURE | {"causes": {"red": "OBJECT_GONE"}, "sessions": [("red", "failed"), ("green", "succeeded")]},
            id="a removed object fails without another attempt",
        ),
        pytest.param(
            TIDY,
            {"script": {"red": lambda world, session: Play(world=world, ticks=0)}},
            FAILURE
            | {
                "ended": {"red": "completed", "green": "completed"},
                "causes": {"red": "NOTHING_CHANGED"},
                "sessions": [("red", "failed"), ("green", "succeeded")],
            },
            id="a skill that reports success and moves nothing fails",
        ),
        pytest.param(
            TIDY,
            {"script": {"red": fail_but_achieve}},
            SUCCESS
            | {
                "ended": {"red": "stalled", "green": "completed"},
                "sessions": [("red", "succeeded"), ("green", "succeeded")],
                "reasons": {"red": "although the execution ended stalled"},
            },
            id="a failed execution that met the objective succeeds",
        ),
        pytest.param(
            TIDY,
            {"refuse": {"red": UNFIT}},
            FAILURE | {"exit_code": 3, "nodes": {"red": "blocked", "green": "done"}, "reasons": {"": "NOT_OFFERED"}},
            id="a refused first session blocks its node and the exit code says so",
        ),
        pytest.param(
            TIDY,
            {"script": {"red": take_green}},
            FAILURE
            | {
                "sessions": [("red", "succeeded"), ("green", "rejected")],
                "reasons": {"": "PRECONDITION_UNMET: found visible(green_cube)"},
            },
            id="an object that vanished before its own session is an objective not met",
        ),
        pytest.param(
            TIDY,
            {"script": {"red": knock_over}},
            FAILURE
            | {
                "sessions": [("red", "failed"), ("green", "failed")],
                "causes": dict.fromkeys(("red", "green"), "CONSTRAINT_VIOLATED"),
                "reasons": {"red": "upright(bottle) was false at 1.00 s"},
            },
            id="a violated constraint that cannot be undone fails",
        ),
        pytest.param(
            OTHER_END,
            {},
            FAILURE
            | {"nodes": {"red": "done", "green": "done"}, "reasons": {"": "inside(blue_cube, blue_tray) is false"}},
            id="its own acceptance is not met although every node is done",
        ),
        pytest.param(
            CHAIN,
            {"refuse": {"red": Problem(code="NO", address="red")}},
            {"nodes": ALL_BLOCKED, "sessions": [("red", "rejected")]},
            id="nodes behind a blocked one are blocked",
        ),
        pytest.param(
            CHAIN,
            {"script": {"red": forget}},
            {"verdict": "failure", "nodes": ALL_BLOCKED | {"red": "done"}, "reasons": {"": "red.outputs.place_site"}},
            id="a node whose output is missing is blocked with the reason",
        ),
        pytest.param(
            TWO_STEPS,
            {"script": {"place": drop}},
            SUCCESS
            | {
                "sessions": [
                    ("pick", "succeeded"),
                    ("place", "replanned"),
                    ("pick.r1", "succeeded"),
                    ("place.r1", "succeeded"),
                ]
            },
            id="a lost object sends the node that held it to work again",
        ),
    ],
)
def test_a_goal_ends_by_what_was_observed_of_it_and_says_why(make_stage, write_graph, graph, stage, expected):
    check_report(make_stage(**stage).pursue(write_graph(graph)), **expected)


@pytest.mark.parametrize("accept", ['["inside(red_cube, red_tray)"]', "[]"])
def test_a_goal_with_a_blocked_node_is_not_met_though_nothing_speaks_against_its_acceptance(
    make_stage, write_graph, accept
):
    graph = write_graph(TIDY.partition("    accept:")[0] + f"    accept: {accept}\n")
    done_already = put(make_world(), "red_cube", (0.55, 0.3, 0.03))

    report = make_stage(world=done_already, refuse={"red": UNFIT}).pursue(graph)

    assert (report.verdict, report.nodes) == ("failure", {"red": "blocked", "green": "done"})


def test_outputs_flow_along_data_edges_and_fan_out_waits(make_stage, write_graph):
    stage = make_stage()
    assert stage.pursue(write_graph(CHAIN)).verdict == "success"
    assert get_order(stage) == ["red", "beside", "each-green_cube", "each-yellow_cube"]
    assert stage.runtime.ran[1].parameters["near"] == pytest.approx([0.55, 0.3, 0.03])


@pytest.mark.parametrize(("code", "tried"), [("NOT_GRASPABLE", ["green", "r1"]), ("NO_SPACE", ["green"])])
def test_a_destination_without_room_is_no_reason_to_try_other_means(make_stage, library, tidy, code, tried):
    """A skill that promised the same was tried there, and moved objects for nothing."""
    add_skills(library, {"slide": SKILLS["pick_and_place"].replace("tree: pick_and_place", "tree: slide")})
    report = make_stage(refuse={"green": Problem(code=code, address="dry run")}).pursue(tidy)

    assert [each.id.rpartition(".")[2] for each in report.sessions if "green" in each.id] == tried


def test_a_finished_node_that_the_world_undid_is_done_again_before_the_verdict(make_stage, tidy):
    stage = make_stage({"green": undo_red})
    sessions = [(id, "succeeded") for id in ("red", "green", "red.r1")]
    check_report(stage.pursue(tidy), verdict="success", sessions=sessions, replans=1)
    assert stage.runtime.ran[2].parent == "tidy-7.red"


def test_a_second_goal_with_the_same_seed_gets_an_id_of_its_own(make_stage, tidy):
    stage = make_stage()
    mission = stage.make_mission()
    first = mission.run(tidy, seed=7)
    stage.runtime.world = make_world()
    second = mission.run(tidy, seed=7)
    third = mission.run(tidy, seed=8)
    assert [first.goal, second.goal, third.goal] == ["tidy-7", "tidy-7-2", "tidy-8"]
    assert second.verdict == "success"


def test_an_agent_that_died_continues_from_the_records_without_submitting_again(make_stage, tidy):
    class Death(Exception):
        pass

    class DiesAfter:
        """Lets the runtime work, then dies before the verdicts are formed."""

        def on_change(self, goal, ledger):
            stage.runtime.on_change(goal, ledger)
            if len(stage.runtime.ran) == 2:
                raise Death

    stage = make_stage({"red": slip})
    with pytest.raises(Death):
        stage.make_mission(observers=[DiesAfter()]).run(tidy, seed=7)
    report = stage.pursue(tidy)
    assert (report.goal, report.verdict) == ("tidy-7", "success")
    assert [s.id for s in report.sessions] == ["tidy-7.red", "tidy-7.green", "tidy-7.red.r1"]


def test_a_session_left_in_verifying_is_judged_again(make_stage, tidy):
    stage = make_stage()

    class InterruptedAgent:
        def on_change(self, goal, ledger):
            stage.runtime.on_change(goal, ledger)
            if stage.runtime.ran:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stage.make_mission(observers=[InterruptedAgent()]).run(tidy, seed=9)
    journal = Journal(stage.workspace.root, side=Side.AGENT, by="other", clock=SystemClock(), durable=False)
    journal.commit([Entry("tidy-9.red", "verify", None, 1)])
    journal.close()
    report = stage.pursue(tidy, seed=9)
    assert report.verdict == "success"
    assert len(report.sessions) == 2


def test_cancel_ends_every_session_and_the_exit_code_says_so(make_stage, tidy):
    stage = make_stage()
    stage.runtime.paused = True
    mission = stage.make_mission()
    mission.cancel()
    report = mission.run(tidy, seed=7)
    assert (report.verdict, report.exit_code) == ("cancelled", 130)
    assert {session.state for session in report.sessions} == {"cancelled"}


def test_a_dead_runtime_ends_the_mission_and_a_later_one_continues(make_stage, tidy):
    stage = make_stage()
    stage.runtime.paused = True
    with pytest.raises(ExecutionError, match=r"no watchdog runs tidy-7\.red, tidy-7\.green"):
        stage.make_mission(is_runtime_alive=lambda _: False).run(tidy, seed=7)
    stage.runtime.paused = False
    stage.runtime.on_change(None, None)
    assert stage.pursue(tidy).verdict == Verdict.SUCCESS


def test_verdicts_are_covered_by_what_the_runtime_waits_for_and_the_end_is_waited_for_here(
    make_stage, tidy, monkeypatch
):
    calls: list[tuple[str, bool]] = []
    commit, sync = Journal.commit, Journal.sync

    def note_commit(journal, entries, *, durable=True):
        if journal._side is Side.AGENT:
            calls.extend((entry.ev, durable) for entry in entries)
        return commit(journal, entries, durable=durable)

    def note_sync(journal):
        calls.append(("sync", True))
        sync(journal)

    monkeypatch.setattr(Journal, "commit", note_commit)
    monkeypatch.setattr(Journal, "sync", note_sync)
    assert make_stage().pursue(tidy).verdict == "success"

    assert calls[0] == ("goal_submitted", True)
    assert ("accept", False) in calls
    assert calls.index(("goal_verdict", False)) < len(calls) - 1
    assert calls[-1] == ("sync", True)


class Silence:
    """A watch that is told nothing."""

    def __init__(self) -> None:
        self.waited_s: list[float] = []

    def wait(self, timeout_s: float) -> bool:
        self.waited_s.append(timeout_s)
        return False


def test_an_agent_without_news_waits_for_the_disk_once(make_stage, monkeypatch):
    mission, synced, silence = make_stage().make_mission(), [], Silence()

    def note(journal) -> None:
        synced.append(journal)

    monkeypatch.setattr(Journal, "sync", note)
    mission._is_durable = False

    assert [mission._wait(silence), mission._wait(silence)] == [False, False]

    assert len(synced) == 1
    assert silence.waited_s == [SYNC_AFTER_S, WAIT_S, WAIT_S]


def test_the_reason_of_a_goal_tells_the_first_cause_before_the_last(make_stage, tidy):
    def stand_still(world, session):
        return Play(world=world, ended=Ended.STALLED, code="STALLED", leaf="pick_and_place/approach")

    report = make_stage({"red": slip, "red.r1": stand_still, "red.r2": stand_still}).pursue(tidy)
    first, last = report.sessions[0].reason, report.sessions[-1].reason
    assert first.rstrip(".") not in last
    assert report.reason == f"node red cannot be done: {first.rstrip('.')}; in the end: {last}"


def test_what_is_not_permitted_is_neither_compiled_nor_used_in_a_repair(make_stage, tidy):
    stage, seen = make_stage(script={"red": slip}), []
    mission = stage.make_mission()

    def restrict(catalogue):
        seen.append(catalogue)
        return replace(catalogue, skills={"pick_and_place": catalogue.skills["pick_and_place"]})

    mission.restrict = restrict
    assert mission.run(tidy, seed=7).verdict == "success"
    assert len(seen[0].skills) > 1
    assert {session.skill for session in stage.runtime.ran} == {"pick_and_place"}

    mission.restrict = lambda catalogue: replace(catalogue, skills={})
    with pytest.raises(DefinitionError, match=r"UNKNOWN_NAME \(skill\)"):
        mission.run(tidy, seed=8)
