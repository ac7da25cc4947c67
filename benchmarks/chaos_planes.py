"""Both planes of one workspace as processes that are attacked, and restarted as a service manager would.

Upstream: `chaos`. Downstream: `paos watch` and `paos agent`. What dies of these two is started again; worlds, workers
and planners are the watchdog's affair. Processes are found by the workspace in their command line.
"""

import contextlib
import os
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.follower import Follower
from phyagentos.store.journal import choose_partition
from phyagentos.store.ledger import Ledger

MARKS = {
    "agent": "phyagentos\0agent\0",
    "watchdog": "phyagentos\0watch\0",
    "worker": "phyagentos.assembly.processes\0worker\0",
    "world": "phyagentos.assembly.processes\0world\0",
    "planner": "phyagentos.runtime.motion.process\0",
}
UNLIMITED = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
RESTART_AFTER_S = 0.5  # a service manager does not spin
LEAVE_S = 30.0  # a planner that is still starting notices only then that its worker is gone
RESTARTS = 40  # then it gives up


def find_processes(root: Path) -> dict[int, str]:
    """Every living process of a workspace: its number, and which it is."""
    found = {}
    for folder in Path("/proc").iterdir():
        if not folder.name.isdecimal():
            continue
        try:
            line = (folder / "cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue
        if str(root) in line:
            names = [name for name, mark in MARKS.items() if mark in line]
            if names:
                found[int(folder.name)] = names[0]
    return found


def prepare(root: Path, graph: Path, lease_s: float, heartbeat_s: float) -> Path:
    """Make the workspace with its own lease; the goal with its own limit of silence, which lies beside it.

    Args:
        root: The workspace.
        graph: The goal as it is shipped.
        lease_s: How long a worker goes on without a sign of its watchdog [s].
        heartbeat_s: How long a worker may be silent [s].
    """
    workspace = Workspace.create(root, Library.open(Path.cwd()))
    change(workspace.runtime_contract, workspace.runtime_contract, r"(?m)^lease_s: \S+", f"lease_s: {lease_s}")
    return change(graph, root.parent / graph.name, "defaults: {", f"defaults: {{heartbeat_s: {heartbeat_s}, ")


def change(source: Path, copy: Path, pattern: str, text: str) -> Path:
    """The same file with one place changed."""
    changed, count = re.subn(pattern, text, source.read_text(encoding="utf-8"))
    if count != 1:
        raise ValueError(f"{source}: {pattern!r} stands there {count} times, expected once")
    copy.write_text(changed, encoding="utf-8")
    return copy


class Planes:
    """`paos watch` and `paos agent` over one workspace.

    Args:
        root: The workspace; made by whichever comes first.
        graph: The goal.
        seed: Of the goal.
        clock: For waiting.
        mode: How the worlds keep time.
    """

    def __init__(self, root: Path, graph: Path, seed: int, clock: Clock, mode: str = "lockstep") -> None:
        self.root, self.goal = root, f"chaos-{seed}"
        self._clock = clock
        place = ["--workspace", str(root)]
        self._commands = {
            "watchdog": ["watch", *place, "--no-pictures", "--trust-python", "--world-mode", mode],
            "agent": ["agent", str(graph), *place, "--seed", str(seed), "--goal", self.goal],
        }
        self._patience = ["nice", "-n", "10"] if mode == "lockstep" else []  # beside worlds that keep real time
        self._log = (root.parent / "planes.log").open("ab")
        self._processes = {name: self._start(name) for name in self._commands}
        self._ended_at_s: dict[str, float] = {}
        self.restarts = dict.fromkeys(self._commands, 0)

    def tend(self) -> bool:
        """Start again what has ended; whether the goal has its verdict."""
        status = self.read_goal()[0]
        is_over = status is not None and bool(status.verdict or status.is_cancelled)
        now_s = self._clock.now_s()
        for name, process in self._processes.items():
            if process.poll() is None or (name == "agent" and is_over):
                continue
            since_s = self._ended_at_s.setdefault(name, now_s)
            if now_s - since_s > RESTART_AFTER_S and self.restarts[name] < RESTARTS:
                self.restarts[name] += 1
                del self._ended_at_s[name]
                self._processes[name] = self._start(name)
        return is_over

    def read_goal(self) -> tuple[GoalStatus | None, list[SessionStatus]]:
        """The goal and its sessions, by the journal; None before anything stands there."""
        sessions = self.root / "sessions"
        if not sessions.is_dir() or not any(sessions.iterdir()):
            return None, []
        ledger, follower = Ledger(forgets=False), Follower(sessions / choose_partition(sessions))
        for record in follower.read_new():
            ledger.apply(record)
        follower.close()
        return ledger.goals.get(self.goal), list(ledger.sessions.values())

    def is_watched(self) -> bool:
        """Whether a watchdog is ready: it alone ends what an earlier one has left."""
        return is_held(self.root / WATCHDOG_LOCK)

    def find(self, name: str) -> int | None:
        """Process id of a victim, None while there is none."""
        return next((pid for pid, found in sorted(find_processes(self.root).items()) if found == name), None)

    def stop(self) -> list[str]:
        """Ask the planes to end; who is still there afterwards, and is then killed."""
        for name in ("agent", "watchdog"):  # the agent first: what it still cancels needs the runtime
            with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
                self._processes[name].terminate()
                self._processes[name].wait(30)
        deadline_s = self._clock.now_s() + LEAVE_S
        while (left := find_processes(self.root)) and self._clock.now_s() < deadline_s:
            self._clock.sleep(0.05)
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        for process in self._processes.values():
            process.wait()
        self._log.close()
        return sorted(left.values())

    def _start(self, name: str) -> "subprocess.Popen[bytes]":
        command = [*self._patience, sys.executable, "-m", "phyagentos", *self._commands[name]]
        return subprocess.Popen(command, stdout=self._log, stderr=self._log, start_new_session=True)


@contextmanager
def small_disk(folder: Path, size_mb: int) -> Iterator[bool]:
    """A file system of its own at `folder`, where this machine allows it; whether it does."""
    command = ["mount", "-t", "tmpfs", "-o", f"size={size_mb}m", "tmpfs", str(folder)]
    is_mounted = os.geteuid() == 0 and subprocess.run(command, capture_output=True, check=False).returncode == 0
    try:
        yield is_mounted
    finally:
        if is_mounted:
            subprocess.run(["umount", "--lazy", str(folder)], check=True, capture_output=True)


def fill(folder: Path) -> Path:
    """Take all that is left of a file system; remove the file to give it back."""
    path = folder / "ballast"
    with path.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        for size in (1 << 20, 4096):
            with contextlib.suppress(OSError):
                while True:
                    file.write(b"\1" * size)
    return path


def refuse_writes(pid: int) -> None:
    """No file of this process grows any more: every write fails with EFBIG, as one to a full disk with ENOSPC."""
    with contextlib.suppress(ProcessLookupError):
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))


def allow_writes(root: Path) -> None:
    """Undo `refuse_writes`, also in children that inherited it."""
    for pid in find_processes(root):
        with contextlib.suppress(ProcessLookupError):
            resource.prlimit(pid, resource.RLIMIT_FSIZE, UNLIMITED)
