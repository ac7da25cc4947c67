"""The two planes as child processes of `paos run`: each in its own process group, with its own log.

With `--with-parent` the kernel signals them when this process dies, and they end. Rejected: threads or forks of this
process (the planes must not share memory, and Ctrl-C in the terminal must reach only us).
"""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from phyagentos.clock import Clock


class Plane:
    """One plane, running.

    Args:
        name: `agent` or `watch`; also the name of the command and of the log.
        arguments: What follows the command.
        logs: Folder of the logs.
    """

    def __init__(self, name: str, arguments: Sequence[str], logs: Path) -> None:
        self.name = name
        self.log = logs / f"{name}.log"
        with self.log.open("ab") as output:
            self._begin = output.tell()  # what an earlier run printed is not ours
            self._process = subprocess.Popen(
                [sys.executable, "-m", "phyagentos", name, *arguments, "--with-parent", str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )

    def find_exit_code(self) -> int | None:
        """The exit code, or None while it runs."""
        return self._process.poll()

    def stop(self, clock: Clock, grace_s: float = 5.0) -> None:
        """Ask it to end; kill it and what it started when it does not."""
        with contextlib.suppress(ProcessLookupError):
            self._process.terminate()
        deadline_s = clock.now_s() + grace_s
        while self._process.poll() is None and clock.now_s() < deadline_s:
            clock.sleep(0.02)
        self.kill()

    def kill(self) -> None:
        """End it at once, with its process group."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def read_printed(self) -> list[str]:
        """The lines that it has printed, for the message about its end."""
        text = self.log.read_bytes()[self._begin :].decode(errors="replace")
        return [line for line in text.splitlines() if line.strip()]
