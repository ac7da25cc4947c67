"""Old evidence is thinned while the runtime plane works: by a process of its own, which gives way to every other."""

import contextlib
import os
import subprocess
import sys

from phyagentos.protocol.sessions.lifecycle import FINAL_STATES
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.records import Record

LOWEST = 19  # nice value
EVERY = 1000  # sessions that ended between two clean-ups


class EvidenceKeeper:
    """Runs `paos evidence prune` of a workspace after every so many sessions; what it prints is in `logs/`."""

    def __init__(self, workspace: Workspace, every: int = EVERY) -> None:
        self._workspace, self._every = workspace, every
        self._ended = 0
        self._process: subprocess.Popen[bytes] | None = None

    def take_in(self, record: Record) -> None:
        """Count sessions that end."""
        self._ended += record.to in FINAL_STATES

    def refresh(self) -> None:
        """Begin a clean-up when one is due and none runs."""
        if self._ended >= self._every and (self._process is None or self._process.poll() is not None):
            self._ended = 0
            command = ["-m", "phyagentos", "evidence", "prune", "--workspace", str(self._workspace.root)]
            with contextlib.suppress(OSError), (self._workspace.logs / "prune.log").open("wb") as log:  # else the next
                self._process = subprocess.Popen(
                    [sys.executable, *command], stdin=subprocess.DEVNULL, stdout=log, stderr=log
                )
                os.setpriority(os.PRIO_PROCESS, self._process.pid, LOWEST)

    def close(self) -> None:
        """End a clean-up that still runs; the next one goes on from there."""
        if self._process is not None:
            self._process.kill()  # manifests are replaced as a whole before anything is deleted
            self._process.wait()
