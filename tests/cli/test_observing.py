"""`paos status`, `runs`, `logs`, and which workspace a command means without `--workspace`."""

import json
import os
import shutil
import subprocess
import sys

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.clock import SystemClock
from phyagentos.operations import status as standing
from phyagentos.operations import stop
from phyagentos.operations.workspaces import find_running
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.estop import Latch, is_latched, latch
from phyagentos.protocol.sessions.stop_signals import take_signals
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, become_sole
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.watch import Watch
from tests.command_line import assert_refused


@pytest.fixture
def here(run, monkeypatch):
    """A folder with two workspaces: `workspaces/new`, in which the run is, and an older one."""
    root = run.workspace.root
    folder = root.parent / "project" / "workspaces"
    folder.mkdir(parents=True)
    Workspace.create(folder / "old", Library(()))
    os.utime(folder / "old" / "workspace.yaml", (1, 1))
    (folder / "new").symlink_to(root)
    monkeypatch.chdir(folder.parent)
    monkeypatch.setattr(standing, "find_running", list)
    run.begin()
    run.submit("red")
    return run


def test_a_reading_command_means_the_newest_workspace_and_names_it(here, paos):
    for command in (("status",), ("why", "red"), ("graph",), ("logs",)):
        result = paos(*command)
        assert result.code == ExitCode.GOAL_MET, command
        assert result.err.splitlines()[0] == "workspace workspaces/new (the newest of 2)"
    assert paos("status", "-w", "workspaces/old").err == ""


def test_where_no_workspace_is_the_next_step_is_named(paos, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(paos("status"), "Name one: --workspace W; `paos store` takes W alone.")
    monkeypatch.setattr(standing, "find_running", list)
    assert "`paos run GRAPH` makes one" in paos("runs").out


def test_status_and_runs_tell_goals_sessions_and_a_latched_stop(here, paos):
    latch(here.workspace.signals.parent, Latch(by="ana", reason="a hand"))
    shown = paos("status").out.splitlines()
    assert shown[0] == "workspaces/new: not running, emergency stop, tidy-7 open, 1 pending"
    assert shown[1] == "  emergency stop by ana: a hand"
    first, second = json.loads(paos("runs", "--json").out)
    assert (first["workspace"], first["goals"], first["latch"]["by"]) == ("workspaces/new", {"tidy-7": "open"}, "ana")
    assert (second["workspace"], second["is_running"]) == ("workspaces/old", False)


def test_logs_print_whole_lines_by_process_and_nothing_that_steers_a_terminal(here, paos):
    (here.workspace.logs / "agent.log").write_text("one\n\x1b[2Jtwo\nunfinished")
    (here.workspace.logs / "watch.log").write_text("three\n")
    assert paos("logs").out == "agent: one\nagent: \N{REPLACEMENT CHARACTER}[2Jtwo\nwatch: three\n"
    assert json.loads(paos("logs", "watch", "--json").out) == {"log": "watch", "line": "three"}
    assert "Did you mean 'agent'?" in paos("logs", "agnet").err


@pytest.mark.slow
def test_logs_follow_what_is_written_later(here):
    log = here.workspace.logs / "agent.log"
    log.write_text("one\n")
    command = [sys.executable, "-m", "phyagentos", "logs", "agent", "-f", "-w", str(here.workspace.root)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as follower:
        assert follower.stdout.readline() == "one\n"
        with log.open("a") as file:
            file.write("two\n")
        assert follower.stdout.readline() == "two\n"
        follower.terminate()


def test_records_of_the_journal_are_printed_as_they_come(here, paos, monkeypatch):
    def wait(*_):
        if "green" in here.nodes:
            raise KeyboardInterrupt
        here.nodes.add("green")
        here.submit("green")

    here.nodes = set()
    monkeypatch.setattr(Watch, "wait", wait)
    result = paos("store", "follow", "workspaces/new", "--json")
    records = [json.loads(line) for line in result.out.splitlines()]
    assert result.code == ExitCode.INTERRUPTED
    assert [each["seq"] for each in records] == [*range(1, len(records) + 1)]
    submitted = {each["id"]: each for each in records if each["ev"] == "submit"}
    assert [*submitted] == ["tidy-7.red", "tidy-7.green"]
    assert (submitted["tidy-7.green"]["to"], submitted["tidy-7.green"]["body"]["skill"]) == (
        "pending",
        "pick_and_place",
    )
    assert "tidy-7.red submit pending" in paos("store", "follow", "workspaces/new").out


@pytest.mark.slow
def test_the_journal_of_a_workspace_in_which_nothing_has_run_is_followed_too(run):
    command = [sys.executable, "-m", "phyagentos", "store", "follow", str(run.workspace.root)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as follower:
        run.begin()
        assert "goal:tidy-7 goal_submitted" in follower.stdout.readline()
        follower.terminate()


def test_what_runs_is_found_wherever_it_is(tmp_path):
    root = Workspace.create(tmp_path / "w", Library(())).root
    assert root not in find_running()
    held = become_sole(root / WATCHDOG_LOCK, SystemClock(), "BUSY", "")
    try:
        assert root in find_running()
    finally:
        os.close(held)


@pytest.fixture
def running(tmp_path, monkeypatch, paos):
    """Two workspaces that count as running; `paos` first, since it lets none count."""
    roots = [Workspace.create(tmp_path / name, Library(())).root for name in ("a", "b")]
    monkeypatch.setattr(stop, "find_running", lambda: roots)
    return [Workspace(root) for root in roots]


def test_stops_without_a_workspace_reach_every_running_one(running, paos):
    assert paos("estop", "--reason", "smoke").code == ExitCode.GOAL_MET
    assert all(is_latched(each.signals.parent) for each in running)
    assert paos("cancel", "all").code == ExitCode.GOAL_MET
    assert [[signal.session for signal in take_signals(each.signals)] for each in running] == [["*"], ["*"]]
    assert "no such session" in paos("pause", "red").err


def test_one_that_cannot_be_stopped_holds_up_no_other_and_is_told(running, paos):
    folder = running[0].signals.parent
    shutil.rmtree(folder)
    folder.write_text("in the way")
    result = paos("estop")
    assert (result.code, is_latched(running[1].signals.parent)) == (ExitCode.INTERNAL_ERROR, True)
    assert str(folder) in result.err


def test_a_reset_names_its_workspace(running, paos):
    paos("estop")
    result = paos("estop", "--reset", "--reason", "clear")
    assert result.code == ExitCode.INVALID_INPUT
    assert all(is_latched(each.signals.parent) for each in running)


def test_a_stop_that_reaches_nothing_says_so(paos):
    result = paos("estop")
    assert (result.code, "NOT_RUNNING" in result.err) == (ExitCode.INVALID_INPUT, True)


@pytest.mark.slow
def test_shells_complete_the_names_of_graphs():
    asked = {"_PAOS_COMPLETE": "complete_bash", "COMP_WORDS": "paos run tidy", "COMP_CWORD": "2"}
    code = "import sys; sys.argv = ['paos']; from phyagentos.__main__ import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | asked, capture_output=True, text=True, check=False
    )
    assert "tidy_table" in done.stdout.split()
