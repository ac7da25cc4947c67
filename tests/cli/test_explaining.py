"""`paos why`, `paos graph` and `paos cancel`: from the records of a workspace."""

import json

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.workspaces import read_ledger
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
from tests.store.evidence_bundles import read_all


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


def test_why_names_verdict_criteria_layer_leaf_numbers_solvers_and_child_and_changes_nothing(replanned, paos):
    leave_evidence(replanned, "tidy-7.red")
    answers = [
        Event(time_s=0.1, kind="planner", code="Approaches", details={"stages": {"calls": {"mink": 45}}}),
        Event(time_s=0.2, kind="planner", code="Motion", details={"stages": {"calls": {"ompl": 2, "toppra": 1}}}),
        Event(time_s=0.3, kind="planner", code="Motion", details={"stages": {"calls": {"toppra": 1}}}),
        Event(time_s=0.4, kind="planner", code="Motion", details={"stages": {}}),  # of an earlier version
    ]
    (replanned.workspace.evidence / "tidy-7.red" / EVENTS).write_bytes(encode_lines(answers))
    before = read_all(replanned.workspace.root)
    lines = paos("why", "red", "--workspace", replanned.workspace.root).out.splitlines()
    assert lines[0] == "tidy-7.red: replanned"
    for said in (
        "execution   skill_failed GRASP_LOST: 6.50 s simulated",
        "verdict     replan, sensing truth",
        "✗ accept inside(red_cube, red_tray): distance_m 0.31",
        "layer       execution",
        "leaf        pick_and_place/place/lower at 6.10 s: GRASP_LOST",
        "numbers     width_m 0.00125",
        "planned by  mink 45, ompl 2, toppra 2 calls",
        "child       tidy-7.red.r1",
    ):
        assert any(said in line for line in lines), said
    assert read_all(replanned.workspace.root) == before


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


@pytest.mark.parametrize("count", [0, 2])
def test_where_there_is_not_one_goal_it_must_be_named(run, paos, count):
    for number in range(count):
        run.write(Side.AGENT, f"goal:g-{number}", "goal_submitted", graph="g", seed=number, objective="")
    for command in ("graph", "why")[: 1 if count else 2]:  # `why` is of the latest goal
        assert_refused(paos(command, "--workspace", run.workspace.root), f"found {count} goals; expected ")


@pytest.mark.parametrize(
    ("command", "said"),
    [
        pytest.param(
            ("graph", "tidy-8"),
            ("UNKNOWN_NAME (goal)", "found 'tidy-8'", "tidy-7", "Did you mean 'tidy-7'?"),
            id="an unknown goal names those that there are and the nearest",
        ),
        pytest.param(
            ("why", "rad"),
            (
                "rad: UNKNOWN_NAME (session): found no such session; expected tidy-7.red, tidy-7.red.r1",
                "Did you mean 'red'?",
            ),
            id="an unknown session names the nearest",
        ),
        pytest.param(
            ("cancel", "tidy-7"),
            ("tidy-7: ALREADY_OVER: found its verdict 'success' is final",),
            id="a goal that has its verdict cannot be cancelled",
        ),
        *(
            pytest.param(
                (kind, "red.r1"),
                ("tidy-7.red.r1: ALREADY_OVER: found its state 'succeeded' is final",),
                id=f"no {kind} is asked of a session that is over",
            )
            for kind in ("cancel", "pause", "resume")
        ),
    ],
)
def test_what_is_not_there_or_over_is_refused_and_nothing_is_asked(replanned, paos, command, said):
    replanned.write(Side.AGENT, "goal:tidy-7", "goal_verdict", verdict="success")
    assert_refused(paos(*command, "--workspace", replanned.workspace.root), *said)
    assert list(take_signals(replanned.workspace.signals)) == []


@pytest.mark.parametrize("kind", ["cancel", "pause", "resume"])
def test_a_request_leaves_a_signal_for_one_session(run, paos, kind):
    run.begin()
    run.submit("red")
    result = paos(kind, "red", "--workspace", run.workspace.root)
    assert result.code == ExitCode.GOAL_MET
    (signal,) = take_signals(run.workspace.signals)
    assert (signal.kind, signal.session, signal.by) == (kind, "tidy-7.red", f"paos {kind}")


def test_a_take_over_names_the_leader_of_the_arm_and_its_keys_need_a_terminal(run, paos):
    run.begin()
    run.submit("red")
    where = ("red", "--workspace", run.workspace.root, "--by", "ada")
    assert_refused(paos("take-over", *where), "its keys need a terminal")
    found = paos("take-over", *where, "--leader", "tcp://127.0.0.1:5555", "--speaks", "joints", "--json")
    (signal,) = take_signals(run.workspace.signals)
    assert found.code == ExitCode.GOAL_MET
    assert (signal.session, signal.by) == ("tidy-7.red", "ada")
    assert (signal.leader, signal.speaks) == ("tcp://127.0.0.1:5555", "joints")


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


def test_cancelling_a_goal_is_recorded_and_asks_for_the_end_of_its_sessions(run, paos):
    run.begin()
    run.submit("red")
    result = paos("cancel", "tidy-7", "--workspace", run.workspace.root, "--reason", "another graph")

    assert result.code == ExitCode.GOAL_MET
    goal = read_ledger(run.workspace.root).goals["tidy-7"]
    assert (goal.is_cancelled, goal.reason) == (True, "another graph")
    assert [signal.session for signal in take_signals(run.workspace.signals)] == ["tidy-7.red"]


@pytest.mark.parametrize(
    ("left", "place", "said"),
    [
        ("", "evidence/tidy-7.red/initial.npz", "NOT_EXECUTED: found no such file; expected "),
        ("initial.snapshot", "evidence/tidy-7.red/initial.npz", "NOT_EXECUTED: found initial.snapshot; expected "),
        ("initial.npz", "TARGETS.md", "UNKNOWN_NAME (target): found 'panda'"),  # it was removed since
    ],
)
def test_a_session_without_a_state_to_start_from_or_its_target_is_not_repeated(replanned, paos, left, place, said):
    root = replanned.workspace.root
    (root / "evidence" / "tidy-7.red").mkdir()
    if left:
        (root / "evidence" / "tidy-7.red" / left).write_bytes(b"state")
    assert_refused(paos("rerun", "tidy-7.red", "-w", root), f"{root / place}: {said}")
    assert not (root / "reruns").exists()


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
