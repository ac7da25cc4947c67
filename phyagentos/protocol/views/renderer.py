"""The rendered documents of the runtime plane: SESSIONS.md and LOG.md, kept in step with the journal.

Upstream: a follower of its own, so it can run in any process and never slows the one that decides. Downstream: people.
TASK.md is the agent's (`tasks`); SKILLRUNTIME.md and TARGETS.md are in `registries`, ENVIRONMENT.md in
`environment_view`.
"""

from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.markdown import publish
from phyagentos.protocol.sessions import SessionId, SessionStatus
from phyagentos.protocol.store.follower import Follower
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.protocol.views.log import describe_record, render_log
from phyagentos.protocol.views.sessions import render_sessions
from phyagentos.protocol.workspace import Workspace

PERIOD_S = 0.2  # a person reads no faster


class Views:
    """Renders the views of one workspace.

    Args:
        workspace: Where they are published.
        lane: Folder of the journal to follow (`Journal.folder`).
        clock: For the rate.
        period_s: Shortest time between two renderings [s].
    """

    def __init__(self, workspace: Workspace, lane: Path, clock: Clock, *, period_s: float = PERIOD_S) -> None:
        self.ledger = Ledger()
        self._workspace = workspace
        self._follower = Follower(lane)
        self._clock = clock
        self._period_s = period_s
        self._lines: list[str] = []
        self._blocks: dict[SessionId, tuple[SessionStatus, str]] = {}
        self._published_seq = -1
        self._published_at_s = -float("inf")

    def refresh(self, *, at_once: bool = False) -> bool:
        """Publish what changed since the last time.

        Args:
            at_once: Even within the period (at the end of a run).

        Returns:
            Whether anything was written.
        """
        for record in self._follower.read_new():
            self.ledger.apply(record)
            if line := describe_record(record, self.ledger):
                self._lines.append(line)
        now_s = self._clock.now_s()
        is_early = now_s - self._published_at_s < self._period_s and not at_once
        if is_early or self.ledger.seq == self._published_seq:
            return False
        publish(self._workspace.sessions_document, render_sessions(self.ledger, self._blocks))
        publish(self._workspace.log, render_log(self._lines, self.ledger.seq))
        self._published_seq, self._published_at_s = self.ledger.seq, now_s
        return True

    def close(self) -> None:
        """Publish what is still due and let go of the journal."""
        self.refresh(at_once=True)
        self._follower.close()
