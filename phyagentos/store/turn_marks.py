"""How far an agent has acted on the journal: all that it wants to submit for now, it has submitted.

Upstream: the mission, before it waits. Downstream: the runtime, which lets the simulated time of a shared world stand
until then. A mark may be lost: it is made again with the next record.
"""

import contextlib
from pathlib import Path

from phyagentos.protocol.sessions.session import GoalId


class TurnMarks:
    """The marks of one workspace, a file for each goal.

    Args:
        cache: The workspace's folder for what may be deleted.
    """

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
            (self._folder / goal).write_bytes(b"%d\n" % seq)

    def read(self, goal: GoalId) -> int:
        """Number of the last record that the agent has acted on; 0 without a mark."""
        with contextlib.suppress(OSError, ValueError):
            return int((self._folder / goal).read_bytes())
        return 0
