"""`paos why`, `paos graph` and `paos cancel`: from the records of a workspace."""

import json

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.registries import read_target_registry
from phyagentos.protocol.sessions.estop import is_latched
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, EVENTS, TRACE, Event, encode_lines, write_json
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.stop_signals import take_signals
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.world.environment import Entity, Environment, Pose
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.views.tasks import render_tasks
from tests.command_line import assert_refused


def observe(time_s: float, x_m: float) -> Environment:
    cube = Entity(name="red_cube", kind="cube", pose=Pose(position_m=(x_m, 0.0, 0.02)), observed_at_s=time_s)
    return Environment(time_s=time_s, scene="s", episode="e", revision=1, sensing="truth", entities={"red_cube": cube})


def leave_evidence(run, id: str) -> None:
    folder = run.workspace.evidence / id
    folder.mkdir()
    write_json(folder / BEFORE, observe(0.0, 0.4))
    write_json(folder / AFTER, observe(6.5, 0.5))
    failure = TraceEvent(
        tick=300,
        time_s=6.1,
        path="pick_and_place/place/lower",
        leaf="move_linear",
        status="FAILURE",
        code="GRASP_LOST",
        message="the fingers touch red_cube from neither side",
        numbers={"width_m": 0.00125},
    )
    (folder / TRACE).write_bytes(encode_lines([failure]))


def test_why_names_verdict_criteria_layer_and_child(replanned, paos):
    leave_evidence(replanned, "tidy-7.red")
    text = paos("why", "red", "--workspace", replanned.workspace.root).out
    assert text.startswith("tidy-7.red: replanned\n")
    assert "execution   skill_failed GRASP_LOST: 6.50 s simulated" in text
    assert "verdict     replan, sensing truth" in text
    assert "✗ accept inside(red_cube, red_tray): distance_m 0.31" in text
    assert "layer       execution" in text
    assert "child       tidy-7.red.r1" in text


def test_why_names_the_leaf_and_the_number_that_decided(replanned, paos):
    leave_evidence(replanned, "tidy-7.red")
    text = paos("why", "red", "--workspace", replanned.workspace.root).out
    assert "leaf        pick_and_place/place/lower at 6.10 s: GRASP_LOST" in text
    assert "numbers     width_m 0.00125" in text


def test_why_counts_the_calls_of_the_solvers_that_planned_a_session(replanned, paos):
    leave_evidence(replanned, "tidy-7.red")
    answers = [
        Event(time_s=0.1, kind="planner", code="Approaches", details={"stages": {"calls": {"mink": 45}}}),
        Event(time_s=0.2, kind="planner", code="Motion", details={"stages": {"calls": {"ompl": 2, "toppra": 1}}}),
        Event(time_s=0.3, kind="planner", code="Motion", details={"stages": {"calls": {"toppra": 1}}}),
        Event(time_s=0.4, kind="planner", code="Motion", details={"stages": {}}),  # of an earlier version
    ]
    (replanned.workspace.evidence / "tidy-7.red" / EVENTS).write_bytes(encode_lines(answers))

    text = paos("why", "red", "--workspace", replanned.workspace.root).out
    assert "planned by  mink 45, ompl 2, toppra 2 calls" in text


def test_why_of_a_session_that_never_ran_says_so(run, paos):
    run.begin()
    run.submit("red")
    assert "execution   none: it has not run" in paos("why", "red", "--workspace", run.workspace.root).out


def test_the_graph_of_a_goal_shows_its_attempts_and_what_comes_before_them(replanned, paos):
    text = paos("graph", "--workspace", replanned.workspace.root).out
    assert text.splitlines() == [
        "tidy-7: Tidy up. (no verdict yet)",
        "  red     past",
        "  red.r1  done         after red (replan)",
        "  blue    waiting      after red.r1",
    ]
    drawing = paos("graph", "tidy-7", "--mermaid", "--workspace", replanned.workspace.root).out
    assert drawing in render_tasks(read_ledger(replanned.workspace.root))
    assert '"<b>red.r1</b><br/>done"]:::done' in drawing
    told = json.loads(paos("graph", "tidy-7", "--json", "--workspace", replanned.workspace.root).out)
    assert told["steps"][1] == {"name": "red.r1", "node": "red", "state": "done", "session": "tidy-7.red.r1"}
    assert {"before": "red.r1", "step": "blue", "relation": "after"} in told["edges"]


def test_an_unknown_goal_names_those_that_there_are_and_the_nearest(replanned, paos):
    assert_refused(
        paos("graph", "tidy-8", "--workspace", replanned.workspace.root),
        "UNKNOWN_NAME (goal)",
        "found 'tidy-8'",
        "tidy-7",
        "Did you mean 'tidy-7'?",
    )


@pytest.mark.parametrize("count", [0, 2])
def test_where_there_is_not_one_goal_the_graph_must_be_named(run, paos, count):
    for number in range(count):
        run.write(Side.AGENT, f"goal:g-{number}", "goal_submitted", graph="g", seed=number, objective="")
    assert_refused(paos("graph", "--workspace", run.workspace.root), f"found {count} goals")


def test_the_graph_of_no_workspace_is_refused(paos, tmp_path):
    assert paos("graph", "--workspace", tmp_path / "nowhere").code == ExitCode.INVALID_INPUT


def test_an_unknown_session_names_the_nearest(replanned, paos):
    assert_refused(
        paos("why", "rad", "--workspace", replanned.workspace.root),
        "rad: UNKNOWN_NAME (session): found no such session; expected tidy-7.red, tidy-7.red.r1",
        "Did you mean 'red'?",
    )


@pytest.mark.parametrize("kind", ["cancel", "pause", "resume"])
def test_a_request_leaves_a_signal_for_one_session(run, paos, kind):
    run.begin()
    run.submit("red")
    result = paos(kind, "red", "--workspace", run.workspace.root)
    assert result.code == ExitCode.GOAL_MET
    (signal,) = take_signals(run.workspace.signals)
    assert (signal.kind, signal.session, signal.by) == (kind, "tidy-7.red", f"paos {kind}")


@pytest.mark.parametrize("kind", ["cancel", "pause", "resume"])
def test_nothing_is_asked_of_a_session_that_is_over(replanned, paos, kind):
    assert_refused(
        paos(kind, "red.r1", "--workspace", replanned.workspace.root),
        "tidy-7.red.r1: ALREADY_OVER: found its state 'succeeded' is final",
    )
    assert list(take_signals(replanned.workspace.signals)) == []


def test_cancel_all_needs_no_session(run, paos):
    paos("cancel", "all", "--workspace", run.workspace.root)
    assert [signal.session for signal in take_signals(run.workspace.signals)] == ["*"]


def test_a_damaged_journal_holds_up_no_stop(run, paos):
    run.begin()
    for path in run.workspace.sessions.rglob("*.md"):
        path.write_bytes(path.read_bytes().replace(b"goal_submitted", b"goal_submittex"))
    assert paos("cancel", "tidy-7", "--workspace", run.workspace.root).code != ExitCode.GOAL_MET
    assert paos("cancel", "all", "--workspace", run.workspace.root).code == ExitCode.GOAL_MET
    assert [signal.session for signal in take_signals(run.workspace.signals)] == ["*"]


@pytest.mark.parametrize("reason", ["too close\x7f", "one \x9b, two \ufffe", "Gef\udce4\udcdf"])
def test_a_stop_is_heard_whatever_its_reason_holds(run, paos, reason):
    place = ("--workspace", run.workspace.root, "--reason", reason)
    assert paos("cancel", "all", *place).code == ExitCode.GOAL_MET
    assert [signal.kind for signal in take_signals(run.workspace.signals)] == ["cancel"]

    run.begin()
    assert paos("cancel", "tidy-7", *place).code == ExitCode.GOAL_MET

    assert paos("estop", *place).code == ExitCode.GOAL_MET
    assert is_latched(run.workspace.signals.parent)
    assert paos("estop", "--reset", *place).code == ExitCode.GOAL_MET
    assert not is_latched(run.workspace.signals.parent)


def test_looking_changes_nothing(replanned, paos):
    leave_evidence(replanned, "tidy-7.red")
    before = {path: path.read_bytes() for path in replanned.workspace.root.rglob("*") if path.is_file()}
    paos("why", "red", "--workspace", replanned.workspace.root)
    assert {path: path.read_bytes() for path in replanned.workspace.root.rglob("*") if path.is_file()} == before


def test_cancelling_a_goal_is_recorded_and_asks_for_the_end_of_its_sessions(run, paos):
    run.begin()
    run.submit("red")
    result = paos("cancel", "tidy-7", "--workspace", run.workspace.root, "--reason", "another graph")

    assert result.code == ExitCode.GOAL_MET
    goal = read_ledger(run.workspace.root).goals["tidy-7"]
    assert (goal.is_cancelled, goal.reason) == (True, "another graph")
    assert [signal.session for signal in take_signals(run.workspace.signals)] == ["tidy-7.red"]


def test_a_goal_that_has_its_verdict_cannot_be_cancelled(replanned, paos):
    replanned.write(Side.AGENT, "goal:tidy-7", "goal_verdict", verdict="success")
    assert_refused(
        paos("cancel", "tidy-7", "--workspace", replanned.workspace.root),
        "tidy-7: ALREADY_OVER: found its verdict 'success' is final",
    )


@pytest.mark.parametrize("left", ["", "initial.snapshot"])
def test_a_session_that_left_no_state_to_start_from_is_not_repeated(replanned, paos, left):
    workspace = replanned.workspace
    folder = workspace.evidence_of("tidy-7.red")
    folder.mkdir()
    if left:
        (folder / left).write_bytes(b"state")

    assert_refused(
        paos("rerun", "tidy-7.red", "-w", workspace.root),
        f"{folder}/initial.npz: NOT_EXECUTED: found {left or 'no such file'}; expected ",
        "Run the goal again",
    )
    assert not (workspace.root / "reruns").exists()


def test_a_session_whose_target_was_removed_is_not_repeated(replanned, paos):
    workspace = replanned.workspace
    folder = workspace.evidence_of("tidy-7.red")
    folder.mkdir()
    (folder / "initial.npz").write_bytes(b"state")
    assert read_target_registry(workspace.target_registry) == {}

    assert_refused(
        paos("rerun", "tidy-7.red", "-w", workspace.root),
        f"{workspace.target_registry}: UNKNOWN_NAME (target): found 'panda'",
    )
    assert not (workspace.root / "reruns").exists()


def test_why_of_a_goal_tells_its_nodes_and_the_first_cause(run, paos):
    run.begin()
    id = run.submit("red")
    run.execute(id)
    leave_evidence(run, id)
    run.judge(id, Verdict.FAILURE, Truth.FALSE)
    run.write(Side.AGENT, "node:tidy-7/red", "node_blocked", reason="the budget is spent")
    run.write(Side.AGENT, "node:tidy-7/blue", "node_blocked", reason="it waits for red, which is blocked")
    run.end("failure")
    place = ("-w", run.workspace.root)
    shown = paos("why", *place).out.splitlines()
    assert shown[0] == "tidy-7: failure"
    assert {"  because     because", "  node        red: blocked", "  node        blue: blocked"} <= set(shown)
    assert "tidy-7.red: blocked the budget is spent" in shown
    assert paos("why", "tidy-7", *place).out.splitlines() == shown

    blocked = paos("why", "blue", *place).out.splitlines()
    assert blocked[:2] == ["tidy-7.blue: blocked it waits for red, which is blocked", "  waits for   red: blocked"]
    assert "  execution   skill_failed GRASP_LOST: 6.50 s simulated, 0 commands, 0 safety interventions" in blocked
    assert paos("why", "tidy-7.blue", *place).out.splitlines() == blocked
    found = json.loads(paos("why", "red", *place, "--json").out)
    assert (found["session"]["state"], found["explanation"][0]) == ("failed", "tidy-7.red: failed")


def test_why_where_nothing_ran_yet_says_so(run, paos):
    assert_refused(paos("why", "-w", run.workspace.root), "found 0 goals; expected a goal that was submitted there")


def test_why_says_that_the_cause_came_back(paos, run):
    run.begin()
    first = run.submit("red")
    for id in (first, run.submit("red", parent=first)):
        leave_evidence(run, id)
        run.execute(id)
        run.judge(id, Verdict.REPLAN, Truth.FALSE)
    assert "repeated" not in paos("why", first, "-w", run.workspace.root).out
    again = paos("why", f"{first}.r1", "-w", run.workspace.root).out
    assert "repeated    GRASP_LOST, 2 times in a row" in again
