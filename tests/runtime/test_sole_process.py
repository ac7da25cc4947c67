"""One process holds a lock; whoever asks finds it, and finds nobody once it is dead."""

import os
import select
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from phyagentos.assembly.runtime_plane import declare_world
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.workspace.process_lock import become_sole, find_sole, is_held, is_held_by
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.supervision.world_process import get_lock
from phyagentos.testing import ManualClock

HOLD = """
import sys
from pathlib import Path
from phyagentos.clock import SystemClock
from phyagentos.protocol.workspace.process_lock import become_sole
become_sole(Path(sys.argv[1]), SystemClock(), "BUSY", "there is one")
print("held", flush=True)
sys.stdin.read()
"""


@contextmanager
def hold(lock):
    """Another process that holds a lock."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", HOLD, str(lock)], text=True, **pipes) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    lock = tmp_path_factory.mktemp("held") / "folder" / "lock"
    with hold(lock) as process:
        yield lock, process


@pytest.fixture
def holder(held):
    """One process for all tests; it runs and has its own text in the lock again after each."""
    lock, process = held
    text = lock.read_text()
    yield held
    lock.write_text(text)
    process.send_signal(signal.SIGCONT)


def test_a_second_process_is_refused_and_told_who_is_there(holder):
    lock, process = holder

    with pytest.raises(ExecutionError, match=rf"BUSY: .*there is one \(process {process.pid}"):
        become_sole(lock, ManualClock(), "BUSY", "there is one")


def test_the_holder_is_found_and_gone_when_it_was_killed(tmp_path):
    with hold(lock := tmp_path / "lock") as process:
        pidfd = find_sole(lock)
        assert is_held(lock)
        signal.pidfd_send_signal(pidfd, signal.SIGKILL)
        ended = select.poll()  # select.select takes no descriptor above 1023
        ended.register(pidfd, select.POLLIN)
        assert ended.poll(10_000)
        os.close(pidfd)

        assert process.wait() == -signal.SIGKILL
    assert find_sole(lock) is None
    assert not is_held(lock)
    os.close(become_sole(lock, SystemClock(), "BUSY", "there is one"))


def test_a_stopped_holder_is_still_there(holder):
    lock, process = holder
    process.send_signal(signal.SIGSTOP)

    assert is_held(lock)


def test_where_nobody_ever_was_nobody_is_found(tmp_path):
    assert find_sole(tmp_path / "lock") is None
    assert not is_held(tmp_path / "lock")


def test_a_lock_file_that_tells_a_foreign_number_is_believed_only_while_it_is_held(tmp_path):
    (tmp_path / "lock").write_text(f"{os.getpid()}\n")

    assert find_sole(tmp_path / "lock") is None


@pytest.fixture
def adopted(tmp_path):
    """A workspace with the world process of an earlier watchdog."""
    workspace = Workspace.create(tmp_path / "w", Library.open())
    with hold(get_lock(workspace.root, "panda")) as process:
        yield workspace, process


@pytest.mark.parametrize(
    ("text", "mode", "lives"),
    [
        (None, None, True),
        (None, WorldMode.LOCKSTEP, True),
        (None, WorldMode.REALTIME, False),
        ("version: 1\nfaults: []\n", None, False),
    ],
)
def test_a_world_that_was_started_otherwise_is_ended_before_it_is_adopted(adopted, tmp_path, text, mode, lives):
    workspace, world = adopted
    faults = None
    if text is not None:
        faults = tmp_path / "faults.yaml"
        faults.write_text(text)

    declare_world(workspace, faults, mode)

    assert (world.poll() is None) == lives
    assert (find_sole(get_lock(workspace.root, "panda")) is not None) == lives


@pytest.mark.parametrize("text", ["{pid}\n", "{pid}.1\n", "{pid:>10}\n", "-1\n", "99999999999999999999.1\n", "../1\n"])
def test_no_lock_file_names_a_process_that_did_not_write_itself_down(holder, text):
    lock, process = holder
    lock.write_text(text.format(pid=process.pid))

    assert find_sole(lock) is None
    assert not is_held_by(lock, process.pid)


def test_the_holder_is_known_by_its_number_and_its_start(holder):
    lock, process = holder

    assert is_held_by(lock, process.pid)
    assert not is_held_by(lock, os.getpid())
