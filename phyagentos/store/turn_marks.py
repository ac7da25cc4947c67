"""How far an agent has acted on the journal: every submission up to that record is made.

The mission notes it before it waits; in a shared world the runtime stops simulated time until then. A lost mark is made
again with the next record.
"""

import contextlib
import os
from pathlib import Path

from phyagentos.protocol.sessions.session import GoalId


class TurnMarks:
    """The marks of one workspace, a file for each goal, below its `cache` folder."""

    def __init__(self, cache: Path) -> None:
        self._folder = cache / "turns"
        self._noted: dict[GoalId, int] = {}

    def note(self, goal: GoalId, seq: int) -> None:
        """The agent has nothing to record for a goal before a record after this number."""
        if self._noted.get(goal) == seq:
            return
        self._noted[goal] = seq
        with contextlib.suppress(OSError):  # a full disk: the runtime goes on after a while
            if len(self._noted) == 1:
                self._folder.mkdir(parents=True, exist_ok=True)
            # in place and of one width: after a truncation some file systems wait for the disk
            fd = os.open(self._folder / goal, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
            try:
                os.write(fd, b"%020d\n" % seq)
            finally:
                os.close(fd)

    def read(self, goal: GoalId) -> int:
        """Number of the last record that the agent has acted on; 0 without a mark."""
        with contextlib.suppress(OSError, ValueError):
            return int((self._folder / goal).read_bytes())
        return 0
