"""The two planes as child processes: each in its own process group, with its own log.

With `--with-parent` the kernel ends a plane when its parent dies. Rejected: threads or forks of the parent (planes must
not share memory, and Ctrl-C in the terminal must reach only the parent).
"""

import contextlib
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.fork_server import start_python
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.workspace import Workspace

STOP_S = 20.0  # a plane that is well ends within this


class Plane:
    """One plane, running: `agent` or `watch`, which names the command and the log; it dies with this process.

    One that `outlives` this process does not.
    """

    def __init__(self, name: str, arguments: Sequence[str], logs: Path, *, outlives: bool = False) -> None:
        bound = [] if outlives else ["--with-parent", str(os.getpid())]
        self.name = name
        self.log = logs / f"{name}.log"
        with self.log.open("ab") as output:
            self._begin = output.tell()  # what an earlier run printed is not ours
            self._process = start_python(["-m", "phyagentos", name, *arguments, *bound], output)

    def find_exit_code(self) -> int | None:
        """The exit code, or None while it runs."""
        return self._process.poll()

    def is_alive(self, _: object = None) -> bool:
        """Whether it runs; a mission may ask it about any goal."""
        return self._process.poll() is None

    def stop(self, clock: Clock, is_urgent: Callable[[], bool] = lambda: False) -> None:
        """Ask it to end; kill it and what it started when it does not in time, or when it becomes urgent."""
        with contextlib.suppress(ProcessLookupError):
            self._process.terminate()
        deadline_s = clock.now_s() + STOP_S
        while self._process.poll() is None and clock.now_s() < deadline_s and not is_urgent():
            clock.sleep(0.02)
        self.kill()

    @contextlib.contextmanager
    def running(self, clock: Clock) -> Iterator["Plane"]:
        """Itself while the block runs; then it is stopped."""
        try:
            yield self
        finally:
            self.stop(clock)

    def kill(self) -> None:
        """End it at once, with its process group."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def read_printed(self) -> list[str]:
        """The lines that it has printed, for the message about its end."""
        text = self.log.read_bytes()[self._begin :].decode(errors="replace")
        return [line for line in text.splitlines() if line.strip()]


def start_watch(
    workspace: Workspace,
    *,
    faults: Path | None = None,
    pictures: bool = True,
    sense: Sensing | None = None,
    expected: Iterable[str] = (),
) -> Plane:
    """The runtime plane of a workspace that no other process supervises; options as of `run_watch`.

    The Python of its skills is run: look at it before, where the workspace may come from elsewhere.
    """
    arguments = ["--workspace", str(workspace.root), "--trust-python"]
    arguments += ["--faults", str(faults)] if faults is not None else []
    arguments += ["--sense", sense] if sense is not None else []
    arguments += [] if pictures else ["--no-pictures"]
    arguments += [f"--expect={target}" for target in expected]
    return Plane("watch", arguments, workspace.logs)
