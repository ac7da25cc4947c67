"""Both planes by hand, and what Ctrl-C does to a run."""

import json
import os
import select
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.heartbeats import read_heartbeats
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, find_sole
from phyagentos.protocol.workspace.workspace import Workspace
from tests.following import wait_until

ROOT = Path(__file__).resolve().parents[2]
GRAPH = ROOT / "examples/projects/01_yaml_skill/goal_graphs/show.yaml"
COUNT = ROOT / "benchmarks/library/goal_graphs/count.yaml"
LIMIT_S = 300

pytestmark = [pytest.mark.journey, pytest.mark.usefixtures("starts_interpreters")]


def start(*arguments: object, cwd: Path = GRAPH.parents[1]) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "phyagentos", *map(str, arguments)]
    return subprocess.Popen(
        command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


@pytest.fixture
def begin():
    """Starts commands, and ends at the end of the test what has not ended."""
    started: list[subprocess.Popen[str]] = []

    def begin(*arguments: object, **options: Path) -> subprocess.Popen[str]:
        started.append(start(*arguments, **options))
        return started[-1]

    yield begin
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def test_an_agent_that_was_there_first_waits_for_its_watch(begin, tmp_path):
    place, here = ("--workspace", tmp_path / "w"), COUNT.parents[1]
    agent = begin("agent", COUNT, *place, cwd=here)
    while not (tmp_path / "w" / "workspace.yaml").exists():
        assert agent.poll() is None, agent.communicate()
    watch = begin("watch", *place, "--no-pictures", "--once-idle", cwd=here)
    ended = [process.communicate(timeout=LIMIT_S) for process in (agent, watch)]
    assert (agent.returncode, watch.returncode) == (ExitCode.GOAL_MET, ExitCode.GOAL_MET), ended
    assert "goal count-0: success" in ended[0][0]


def wait_for(process: subprocess.Popen[str], line: str) -> None:
    for text in process.stderr:
        if text.startswith(line):
            return
    pytest.fail(f"never said {line!r}")


def test_one_interrupt_cancels_every_session_and_leaves_records_though_heartbeats_were_deleted(begin, tmp_path):
    here, root = copy_endless_counter(tmp_path / "library"), tmp_path / "w"
    run = begin("run", here / "goal_graphs" / "count.yaml", "-w", root, "--no-pictures", cwd=here)
    wait_for(run, "a: running")
    shutil.rmtree(root / "heartbeats", ignore_errors=True)  # a beat may come in between
    wait_until(lambda: list((root / "heartbeats").glob("*.json")), "a heartbeat")
    run.send_signal(signal.SIGINT)
    out, err = run.communicate(timeout=LIMIT_S)
    assert run.returncode == ExitCode.INTERRUPTED, err
    assert "cancelling: the robot is being halted" in err
    assert "interrupted by the operator" in out
    assert "lost" not in out + err
    assert find_states(root)["count-0.a"] == "cancelled"
    assert read_ledger(root).goals["count-0"].is_cancelled


@pytest.mark.parametrize("killed", ["watchdog", "run"])
def test_a_goal_of_which_a_process_was_killed_is_continued_by_the_next_run(begin, tmp_path, killed):
    here, root = copy_endless_counter(tmp_path / "library"), tmp_path / "w"
    graph = here / "goal_graphs" / "count.yaml"
    run = begin("run", graph, "-w", root, "--no-pictures", cwd=here)
    wait_for(run, "a: running")
    watch = find_sole(root / WATCHDOG_LOCK)
    if killed == "run":
        run.kill()
    else:
        signal.pidfd_send_signal(watch, signal.SIGKILL)
    _, err = run.communicate(timeout=LIMIT_S)
    assert select.select([watch], [], [], LIMIT_S)[0], "a plane outlives its run"
    os.close(watch)
    if killed == "watchdog":
        assert run.returncode == ExitCode.INTERNAL_ERROR, err
        assert f"The goal is not over. Continue it: paos run {graph} --seed 0 -w {root}" in err
    shown, _ = begin("status", "-w", root, cwd=here).communicate(timeout=LIMIT_S)
    again = shown.partition("count-0 has no verdict yet; continue it: paos ")[2].split()

    begin(*again, "--no-pictures", cwd=here)

    wait_until(lambda: find_states(root).get("count-0.a.r1") == "running", "another attempt")
    assert list(read_ledger(root).goals) == ["count-0"]


def test_a_second_interrupt_ends_at_once(begin, tmp_path):
    process = begin("run", COUNT, "--workspace", tmp_path / "w", "--no-pictures", cwd=COUNT.parents[1])
    wait_for(process, "workspace")
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=LIMIT_S)
    assert process.returncode == ExitCode.INTERRUPTED


@pytest.mark.parametrize(
    ("lost", "asked", "code"),
    [(signal.SIGKILL, 1, ExitCode.INTERNAL_ERROR), (signal.SIGSTOP, 2, ExitCode.INTERRUPTED)],
    ids=["the watch is gone", "asked twice"],
)
def test_an_agent_that_is_asked_to_end_waits_only_for_a_watch_that_holds_its_lock(begin, tmp_path, lost, asked, code):
    project, root = copy_endless_counter(tmp_path / "library"), tmp_path / "w"
    place = ("--workspace", Workspace.create(root, Library.open(project)).root)
    watch, agent = begin("watch", *place, "--no-pictures", "--trust-python"), begin("agent", COUNT, *place)
    wait_until(lambda: [each.state for each in read_ledger(root).sessions.values()] == ["running"], "a running session")
    watch.send_signal(lost)
    agent.send_signal(signal.SIGTERM)
    wait_until(lambda: read_ledger(root).goals["count-0"].is_cancelled, "the cancellation")
    if asked == 2:
        with pytest.raises(subprocess.TimeoutExpired):
            agent.wait(1.0)
        agent.send_signal(signal.SIGTERM)
    _, err = agent.communicate(timeout=20)
    assert agent.returncode == code, err
    assert ("no watchdog brings count-0.a to rest" in err) == (asked == 1)


def copy_endless_counter(folder: Path) -> Path:
    """The counter's library, whose only leaf never ends: its sessions run, each step in a hundredth of a second."""
    shutil.copytree(COUNT.parents[1], folder)
    leaf = folder / "skills" / "advance" / "behaviours.py"
    source, ends = leaf.read_text(), "        return self.succeed()\n"
    assert ends in source
    stays = "        import threading\n\n        threading.Event().wait(0.01)\n        return Status.RUNNING\n"
    leaf.write_text(source.replace(ends, stays))
    return folder


def find_states(root: Path) -> dict[str, str]:
    return {id: status.state for id, status in read_ledger(root).sessions.items()}


def has_ended(root: Path, goal: str) -> bool:
    ledger = read_ledger(root)
    return ledger.goals[goal].is_cancelled and goal not in {each.contract.goal for each in ledger.live_sessions()}


def test_a_second_run_or_watch_is_refused_and_the_first_follows_its_own_goal(begin, tmp_path):
    here = copy_endless_counter(tmp_path / "library")
    graph, root = here / "goal_graphs" / "count.yaml", tmp_path / "w"
    first = begin("run", graph, "-w", root, "--no-pictures", "--json", cwd=here)
    wait_until(
        lambda: (root / "workspace.yaml").exists() and find_states(root).get("count-0.a") == "running", "a session"
    )

    for second in (("run", graph, "--seed", 3), ("watch",)):
        refused = begin(*second, "-w", root, "--no-pictures", cwd=here)
        _, err = refused.communicate(timeout=LIMIT_S)
        assert refused.returncode == ExitCode.INVALID_INPUT, err
        assert "BUSY" in err
        assert f"paos agent GRAPH -w {root}" in err
    assert list(read_ledger(root).goals) == ["count-0"]

    begin("agent", graph, "-w", root, "--seed", 5, cwd=here)
    wait_until(lambda: "count-5" in read_ledger(root).goals, "another goal")
    for goal in ("count-5", "count-0"):
        assert first.poll() is None
        begin("cancel", goal, "-w", root).communicate(timeout=LIMIT_S)
        wait_until(lambda goal=goal: has_ended(root, goal), "the end")
    out, err = first.communicate(timeout=LIMIT_S)
    assert first.returncode == ExitCode.INTERRUPTED, err
    assert json.loads(out)["goal"]["goal"] == "count-0"


def test_a_cancel_while_the_watchdog_is_stopped_reaches_the_target_by_the_end_of_the_lease(begin, tmp_path):
    workspace = Workspace.create(tmp_path / "w", Library.open(copy_endless_counter(tmp_path / "library")))
    root, place = workspace.root, ("--workspace", workspace.root)
    contract = workspace.runtime_contract
    contract.write_text(contract.read_text().replace("lease_s: 15.0", "lease_s: 2.0"))
    watch, _ = begin("watch", *place, "--no-pictures", "--trust-python"), begin("agent", COUNT, *place)
    wait_until(lambda: find_states(root).get("count-0.a") == "running", "a running session")
    wait_until(lambda: read_heartbeats(workspace.heartbeats)["counter"].tick, "its worker to execute it")
    watch.send_signal(signal.SIGSTOP)
    begin("cancel", "count-0", *place).communicate(timeout=LIMIT_S)
    wait_until(lambda: read_heartbeats(workspace.heartbeats)["counter"].phase == "idle", "rest")
    watch.send_signal(signal.SIGCONT)
    wait_until(lambda: find_states(root)["count-0.a"] == "cancelled", "the end")
    assert read_ledger(root).sessions["count-0.a"].execution.code == "LEASE_LOST"


def test_a_session_of_a_cancelled_goal_ends_though_both_planes_were_killed(begin, tmp_path):
    project, root = copy_endless_counter(tmp_path / "library"), tmp_path / "w"
    place = ("--workspace", Workspace.create(root, Library.open(project)).root)
    planes = begin("watch", *place, "--no-pictures", "--trust-python"), begin("agent", COUNT, *place)
    wait_until(lambda: find_states(root).get("count-0.a") == "running", "a running session")
    for plane in planes:
        plane.kill()
    begin("cancel", "count-0", *place).communicate(timeout=LIMIT_S)

    begin("watch", *place, "--no-pictures", "--trust-python")

    wait_until(lambda: find_states(root)["count-0.a"] in {"awaiting_verification", "cancelled"}, "an observation")
    wait_until(lambda: find_states(root)["count-0.a"] == "cancelled", "the end", 10.0)


def test_a_command_that_is_terminated_leaves_no_temporary_folder(begin, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    command = begin("preflight", GRAPH)
    wait_until(lambda: list(tmp_path.glob("paos-*")) or command.poll() is not None, "a temporary folder")
    command.terminate()
    _, err = command.communicate(timeout=LIMIT_S)
    assert command.returncode == ExitCode.INTERRUPTED, err
    assert list(tmp_path.glob("paos-*")) == []


@pytest.mark.parametrize("plane", ["agent", "watch"])
def test_a_plane_whose_parent_died_before_it_could_look_ends(begin, tmp_path, plane):
    graph = [COUNT] if plane == "agent" else []
    process = begin(plane, *graph, "--workspace", tmp_path / "w", "--with-parent", os.getppid())
    process.communicate(timeout=20)
    assert process.returncode == ExitCode.INTERRUPTED
