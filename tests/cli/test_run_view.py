"""What `paos run` shows and reports, read from a real journal that a test wrote as the planes would."""

import io
import json
import os
import re
import signal
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
from msgspec.structs import replace as change
from rich.console import Console

from phyagentos import errors
from phyagentos.assembly.paths import choose_folder
from phyagentos.cli import mission_run
from phyagentos.cli.console import RunConsole, build_progress_table
from phyagentos.cli.final_table import print_report
from phyagentos.cli.outcome import ExitCode
from phyagentos.clock import SystemClock
from phyagentos.errors import Problem
from phyagentos.operations import run as carrying_out
from phyagentos.operations.progress import RunFold
from phyagentos.operations.run import (
    Interrupts,
    PlaneEnded,
    RunRequest,
    ask_for_end,
    build_report,
    follow_run,
    mute_if_gone,
    run_goal,
)
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.estop import Latch, latch
from phyagentos.protocol.sessions.heartbeats import Heartbeat, write_heartbeat
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.stop_signals import take_signals
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.environment import Entity, Pose, Relation, Snapshot
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.renderer import Views
from phyagentos.store.views.tasks import render_tasks

GOAL = "tidy-7"


@pytest.fixture
def screen(capsys):
    """Reads what was printed beside a result since it was read last."""
    return lambda: capsys.readouterr().err


def narrate(run, times=1, **options):
    with RunConsole("tidy", **options) as console:
        for _ in range(times):
            console.show(run.fold)


def print_end(run, width):
    text = io.StringIO()
    print_report(build_report(run.fold, 2.0), run.fold.rows(), Console(file=text, width=width))
    return text.getvalue()


def test_rows_follow_the_graph_children_follow_their_parents_and_wall_time_begins_with_the_claim(replanned):
    rows = replanned.fold.rows()
    assert [(row.name, row.state, row.depth) for row in rows] == [
        ("red", "replanned", 0),
        ("red.r1", "succeeded", 0),
        ("blue", "waiting", 1),
    ]
    assert rows[0].wall_s == pytest.approx(6.0)  # claim, then six records a second apart


def test_the_active_leaf_and_its_time_are_shown(run):
    run.begin()
    id = run.submit("red")
    run.write(Side.RUNTIME, id, "claim")
    run.write(Side.RUNTIME, id, "check", 1)
    run.write(Side.RUNTIME, id, "start", 1)
    beat = Heartbeat(target="panda", pid=1, session=id, sim_time_s=3.24, leaf="pick/lift", phase="executing")
    write_heartbeat(run.workspace.heartbeats, beat)
    text = io.StringIO()
    Console(file=text, width=100).print(build_progress_table("tidy", run.fold.rows()))
    assert "executing pick/lift" in text.getvalue()
    assert "3.2 s" in text.getvalue()


@pytest.mark.parametrize("width", [60, 100])
def test_state_and_time_of_every_row_stand_on_a_narrow_screen(replanned, width):
    fold, text = replanned.fold, io.StringIO()
    rows = [replace(row, node=f"{row.node}_with_a_long_name_of_its_own", depth=3) for row in fold.rows()]
    Console(file=text, width=width).print(build_progress_table("tidy", rows, width))
    lines = text.getvalue().splitlines()[2:]
    assert len(lines) == len(rows)
    assert all(row.state in line and len(line) <= width for row, line in zip(rows, lines, strict=True))


def test_the_world_is_a_line_that_begins_with_what_distinguishes_an_object(replanned):
    assert replanned.fold.describe_world() == ""
    held = {"a": "arm"}
    entities = {name: Entity(name=name, kind="thing", pose=Pose(), held_by=held.get(name, "")) for name in "abcd"}
    said = [("on", "c", "table"), ("on", "d", "table"), ("inside", "b", "tray"), ("near", "b", "c")]
    relations = tuple(Relation(name=name, arguments=tuple(of)) for name, *of in (*said, ("closed", "door")))
    facts = {"time_s": 1.25, "scene": "s", "episode": "e", "revision": 1, "sensing": "truth"}
    snapshot = Snapshot(**facts, entities=entities, relations=relations)
    block = json.dumps(msgspec.to_builtins(snapshot))
    replanned.workspace.environment.write_text(f"---\nphy: environment/1\n---\n## Snapshot\n\n```yaml\n{block}\n```\n")
    line = replanned.fold.describe_world()
    assert line == "world at 1.2 s: a held by arm, b inside tray, c on table, d on table"


def test_without_a_terminal_every_change_is_one_line_said_once_and_quiet_says_nothing(replanned, screen):
    narrate(replanned, quiet=True)
    assert screen() == ""
    narrate(replanned, times=2)
    lines = screen().splitlines()
    assert lines[:2] == ["red: replanned  GRASP_LOST", "    ✗ inside(red_cube, red_tray)  distance_m 0.31"]
    assert len([line for line in lines if line.startswith("red.r1: succeeded")]) == 1


def test_no_word_of_a_goal_or_a_session_commands_the_terminal_or_stands_in_a_document(run, paos, screen):
    evil = "\x1b]0;owned\x07\x1b[2J\x9b31m"
    run.write(Side.AGENT, f"goal:{GOAL}", "goal_submitted", graph="tidy", seed=7, objective=evil)
    nodes = {"red": {"objective": evil, "skill": "s", "target": "arm", "after": [], "reasons": [evil]}}
    run.write(Side.AGENT, f"goal:{GOAL}", "goal_compiled", nodes=nodes, accept=[evil], constraints=[])
    id = run.submit("red")
    run.write(Side.OPERATOR, id, "cancel", reason=evil)
    run.end("failure")
    narrate(run)
    texts = [screen(), paos("why", id, "-w", run.workspace.root).out, render_tasks(run.fold.ledger)]
    views = Views(run.workspace, run.pens[Side.RUNTIME].folder, run.clock, EditIntake(run.workspace, run.clock))
    views.refresh()
    views.close()
    texts += [path.read_text() for path in run.workspace.root.glob("*.md")]
    assert "31m" in texts[0]  # the words are kept
    assert [text for text in texts if re.search("[\x00-\x08\x0b-\x1f\x7f-\x84\x86-\x9f]", text)] == []


def test_the_report_is_one_json_value_with_every_judgement(replanned):
    replanned.end("success")
    report = build_report(replanned.fold, 2.0)
    data = json.loads(msgspec.json.encode(report))
    assert (data["exit_code"], data["goal"]["verdict"]) == (0, "success")
    assert [session["id"] for session in data["goal"]["sessions"]] == [f"{GOAL}.red", f"{GOAL}.red.r1"]
    assert data["goal"]["sessions"][0]["criteria"][0]["measured"] == {"distance_m": 0.31}
    assert data["goal"]["first_attempt_success"] == {"red": False, "blue": False}


def test_pictures_of_a_report_end_with_those_of_the_session_that_ended_last(replanned):
    sessions = replanned.fold.ledger.sessions
    for id in (f"{GOAL}.red", f"{GOAL}.red.r1"):
        (replanned.workspace.evidence / id).mkdir()
        (replanned.workspace.evidence / id / "after.png").write_bytes(b"")
    assert [*build_report(replanned.fold, 2.0).pictures] == [f"{GOAL}.red", f"{GOAL}.red.r1"]
    sessions[f"{GOAL}.red"] = msgspec.structs.replace(sessions[f"{GOAL}.red"], updated_at="2999-01-01T00:00:00Z")
    assert [*build_report(replanned.fold, 2.0).pictures] == [f"{GOAL}.red.r1", f"{GOAL}.red"]


def test_the_final_table_names_nodes_verdicts_times_and_pictures(replanned):
    picture = replanned.workspace.evidence / f"{GOAL}.red" / "after.png"
    picture.parent.mkdir()
    picture.write_bytes(b"")
    replanned.end("failure")
    text, root = print_end(replanned, 160), replanned.workspace.root
    for said in ("goal tidy-7: not met  because", "6.5 s", "the criterion holds"):
        assert said in text
    assert text.count(str(picture)) == 1
    assert text.endswith(f"next: paos why -w {root} (what decided)\n      paos view -w {root} (the run, on a page)\n")


def test_what_decided_a_goal_and_what_held_all_through_are_said_once(run, screen):
    run.begin()
    id = run.submit("red")
    run.execute(id)
    upright = Criterion(text="upright(bottle)", kind="hold", truth=Truth.TRUE, because="bottle leans 0°")
    inside = Criterion(text="inside(a, b)", kind="accept", truth=Truth.FALSE, because="a is 49 mm beyond b")
    run.decide(id, Attempt(verdict=Verdict.SUCCESS, criteria=(upright, change(upright, kind="constraint"))))
    narrate(run)
    assert screen().count("upright(bottle)") == 1
    run.end("failure", "inside(a, b) no longer holds: a is 49 mm beyond b", (inside, upright))
    assert re.findall("49 mm beyond|✗ .*|✓ .*", print_end(run, 160)) == [
        "49 mm beyond",
        "✗ inside(a, b)",
        "✓ upright(bottle)  bottle leans 0°",
    ]


def test_a_success_whose_execution_was_lost_is_never_shown_as_plain_success(run, screen):
    run.begin()
    id = run.submit("red")
    run.execute(id, Ended.RUNNER_LOST)
    run.judge(id, Verdict.SUCCESS, Truth.TRUE)
    run.end("success")
    narrate(run)
    text = print_end(run, 200)
    for shown in (screen(), text):
        assert "but the execution failed: runner_lost GRASP_LOST" in shown
    assert "succeeded (execution failed)" in text
    assert "the criterion holds, but" in text


@pytest.mark.parametrize(
    ("verdict", "is_rejected", "code"),
    [
        ("success", False, ExitCode.GOAL_MET),
        ("failure", False, ExitCode.GOAL_NOT_MET),
        ("failure", True, ExitCode.REJECTED),
        (None, False, ExitCode.INTERNAL_ERROR),
    ],
    ids=["met", "not met", "rejected by preflight", "without a verdict"],
)
def test_the_verdict_decides_the_exit_code(run, verdict, is_rejected, code):
    run.begin()
    if is_rejected:
        reject(run, "NO_FREE_SITE")
    if verdict is not None:
        run.end(verdict)
    assert build_report(run.fold, 2.0).exit_code == code


def test_a_run_follows_its_own_goal_whatever_is_submitted_beside_it(run):
    run.begin()
    fold = RunFold(run.workspace, "tidy-8", run.fold.ledger)
    run.write(Side.AGENT, "goal:tidy-9", "goal_submitted", graph="tidy", seed=9)
    assert fold.goal is None
    run.write(Side.AGENT, "goal:tidy-8", "goal_submitted", graph="tidy", seed=8)
    run.write(Side.OPERATOR, "goal:tidy-9", "goal_cancelled", reason="of another run")
    assert (fold.goal.id, fold.goal.is_cancelled) == ("tidy-8", False)


def test_the_first_interrupt_cancels_the_goal_and_leaves_its_sessions_to_the_agent(run):
    run.begin()
    run.submit("red")
    ask_for_end(run.fold, run.pens[Side.OPERATOR])
    assert read_ledger(run.workspace.root).goals[GOAL].is_cancelled
    assert take_signals(run.workspace.signals) == []


@pytest.mark.parametrize("goal", ["tidy-8", GOAL], ids=["before there is a goal", "after the verdict"])
def test_an_interrupt_ends_nothing_of_others_and_nothing_that_is_over(run, goal):
    run.begin()
    run.end("success")
    ask_for_end(RunFold(run.workspace, goal, run.fold.ledger), run.pens[Side.OPERATOR])
    assert (take_signals(run.workspace.signals), run.pens[Side.OPERATOR].read_new()) == ([], [])


def test_a_cancelled_goal_leaves_no_session_that_waits_though_no_plane_is_left(run, paos):
    run.begin()
    judged_never, claimed_never = run.submit("red"), run.submit("blue")
    run.execute(judged_never)

    assert paos("cancel", GOAL, "-w", run.workspace.root).code == 0

    ledger = read_ledger(run.workspace.root)
    assert [ledger.sessions[id].state for id in (judged_never, claimed_never)] == ["cancelled", "cancelled"]


@pytest.mark.parametrize(
    ("number", "handler", "count"),
    [
        (signal.SIGINT, signal.default_int_handler, 2),
        (signal.SIGHUP, signal.SIG_DFL, 1),  # the kernel reports it, and then the shell
        (signal.SIGHUP, signal.SIG_IGN, 0),
    ],
    ids=["interrupted twice", "a terminal that hangs up never insists", "kept alive beyond its terminal"],
)
def test_interrupts_are_counted_and_the_handlers_given_back(number, handler, count):
    outside = signal.signal(number, handler)
    try:
        with Interrupts().counted() as interrupts:
            signal.raise_signal(number)
            signal.raise_signal(number)
            assert interrupts.count == count
        assert signal.getsignal(number) is handler
    finally:
        signal.signal(number, outside)


def test_what_is_written_to_a_terminal_that_is_gone_goes_nowhere():
    screen, terminal = os.openpty()
    os.close(screen)
    with pytest.raises(OSError, match="Input/output"):
        os.write(terminal, b"cancelling")
    mute_if_gone(terminal)
    assert os.write(terminal, b"cancelling") == 10
    os.close(terminal)


@dataclass
class EndedPlane:
    """Printed what it was told to print, and ended."""

    log: Path
    printed: list[str] = field(default_factory=list)
    name: str = "agent"

    def find_exit_code(self):
        return 0

    def read_printed(self):
        return self.printed


def follow(run, tmp_path):
    with RunConsole("tidy") as console:
        pen, interrupts = run.pens[Side.OPERATOR], Interrupts()
        show = partial(mission_run.show_run, console, interrupts, run.clock, run.clock.now_s() + mission_run.WARM_UP_S)
        follow_run(run.fold, pen, [EndedPlane(tmp_path)], interrupts, run.clock, show)


def test_a_session_that_an_earlier_goal_has_left_is_not_waited_for(run, screen, tmp_path):
    run.begin()
    run.write(Side.RUNTIME, run.submit("red"), "claim")
    run.write(Side.OPERATOR, f"goal:{GOAL}", "goal_cancelled", reason="twice")
    run.fold = RunFold(run.workspace, "tidy-8", run.fold.ledger)
    run.write(Side.AGENT, "goal:tidy-8", "goal_submitted", graph="tidy", seed=8)
    run.write(Side.AGENT, "goal:tidy-8", "goal_verdict", verdict="success", criteria=[], reason="because")

    follow(run, tmp_path)

    assert build_report(run.fold, 2.0).exit_code == ExitCode.GOAL_MET


def test_a_latched_emergency_stop_is_told_once_with_its_way_out(run, screen, tmp_path):
    latch(run.workspace.signals.parent, Latch(by="paos estop", reason="a hand in the cell"))
    run.begin()
    run.end("success")

    follow(run, tmp_path)
    message = screen()

    assert message.count("emergency stop latched by paos estop (a hand in the cell)") == 1
    assert f"paos estop -w {run.workspace.root} --reset --reason ... lets it go on" in message


@pytest.mark.parametrize(
    ("free_bytes", "printed", "said"),
    [
        (0, [], "it printed nothing, and its disk is full"),
        (10**9, [], "it printed nothing. Log"),
        (0, ["a defect"], "a defect Log"),
    ],
)
def test_a_plane_that_ended_without_a_word_on_a_full_disk_says_so(tmp_path, monkeypatch, free_bytes, printed, said):
    monkeypatch.setattr(errors.shutil, "disk_usage", lambda _: SimpleNamespace(free=free_bytes))
    with pytest.raises(PlaneEnded, match=said):
        raise PlaneEnded(EndedPlane(tmp_path, printed))


def test_a_new_workspace_is_chosen_every_time(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = choose_folder(Path("workspaces"), "tidy-7")
    assert first.as_posix() == "workspaces/tidy-7-1"
    first.mkdir(parents=True)
    assert choose_folder(Path("workspaces"), "tidy-7").as_posix() == "workspaces/tidy-7-2"


def test_whoever_has_read_of_the_workspace_can_interrupt_at_once(tmp_path, monkeypatch):
    counted = []

    class Enough(Exception): ...

    def insist(_text):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    def choose_goal(*_):
        counted.append(interrupts.count)
        raise Enough

    interrupts = Interrupts()
    monkeypatch.setattr(carrying_out, "choose_goal", choose_goal)
    with pytest.raises(Enough):
        run_goal(RunRequest(graph=Path("tidy_table"), workspace=tmp_path / "w"), interrupts, SystemClock(), insist)

    assert counted == [2]


def reject(run, *codes: str) -> str:
    id = run.submit("red")
    problems = [Problem(code, "red", "too far") for code in codes]
    run.write(Side.RUNTIME, id, "claim")
    run.write(Side.RUNTIME, id, "check", 1)
    reason = "; ".join(map(str, problems))
    run.write(Side.RUNTIME, id, "reject", 1, reason=reason, problems=msgspec.to_builtins(problems))
    return reason


@pytest.mark.parametrize("is_in_goal", [True, False])
def test_the_sentences_of_a_rejection_are_printed_once(run, screen, is_in_goal):
    run.begin()
    reason = reject(run, "OUT_OF_REACH", "NO_FREE_SITE")
    why = f"red cannot be done: {reason}" if is_in_goal else "because"
    run.write(Side.AGENT, f"goal:{GOAL}", "goal_verdict", verdict="failure", criteria=[], reason=why)
    narrate(run)
    text = screen() + print_end(run, 300)
    assert text.count("red: OUT_OF_REACH: found too far") == 1
    assert "red: rejected  OUT_OF_REACH, NO_FREE_SITE\n" in text


@pytest.mark.parametrize(("waited_s", "tick", "is_told"), [(1.0, 0, False), (9.0, 0, True), (9.0, 1, False)])
def test_a_run_that_does_not_move_yet_says_that_it_warms_up(
    run, monkeypatch, screen, tmp_path, waited_s, tick, is_told
):
    run.begin()
    id = run.submit("red")
    write_heartbeat(run.workspace.heartbeats, Heartbeat(target="panda", pid=1, session=id, tick=tick))
    beginning = iter([run.clock.now_s()])
    monkeypatch.setattr(run.clock, "now_s", lambda now=run.clock.now_s: next(beginning, now() + waited_s))
    with pytest.raises(PlaneEnded):
        follow(run, tmp_path)
    assert ("warming up" in screen()) is is_told


def test_a_latched_stop_is_told_before_anything_starts_and_even_when_quiet(run, monkeypatch, screen):
    latch(run.workspace.signals.parent, Latch(by="ana", reason="a hand"))

    class Started(Exception): ...

    def start(*_: object) -> None:
        assert "emergency stop latched by ana (a hand)" in screen()
        raise Started

    monkeypatch.setattr(carrying_out, "start_planes", start)
    request = RunRequest(graph=Path("tidy_table"), workspace=run.workspace.root)
    with pytest.raises(Started):
        mission_run.run_shown(request, quiet=True)
