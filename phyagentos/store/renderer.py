"""The rendered documents of the runtime plane: SESSIONS.md and LOG.md, kept in step with the journal.

It follows the journal itself, so it can run in any process, or shares that process's fold.
"""

from collections.abc import Callable
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record
from phyagentos.store.views.log import LogTail
from phyagentos.store.views.page_history import History

PERIOD_S = 0.2  # a person reads no faster
SHARE = 0.01  # of the time at most
CLOSING_TURNS = 3  # an edit comes out with the first rendering, is shown by the second


class Views:
    """Renders the views of one workspace from the journal in `partition`, every `period_s` at most."""

    def __init__(
        self,
        workspace: Workspace,
        partition: Path,
        clock: Clock,
        edits: EditIntake,
        *,
        period_s: float = PERIOD_S,
    ) -> None:
        self._workspace, self._clock, self._edits, self._period_s = workspace, clock, edits, period_s
        self._log = LogTail()
        self._history = History(partition, on_record=self._log.take)
        self._published_seq = -1
        self._due_at_s = -float("inf")

    def share(self, ledger: Ledger, follow: Callable[[], None]) -> None:
        """Use a fold of this process; see `History.share`."""
        self._history.share(ledger, follow)

    def take_in(self, record: Record) -> None:
        """A record was applied to the shared fold."""
        self._history.take_in(record)

    @property
    def ledger(self) -> Ledger:
        """The fold, as of the last `refresh`."""
        return self._history.ledger

    def refresh(self, *, at_once: bool = False) -> bool:
        """Take in what changed and publish it, within the period only if `at_once`; whether anything was written."""
        self._history.read_new()
        is_edited = self._edits.take(self._history, at_once=at_once) or self._edits.file.is_touched()
        begin_s = self._clock.now_s()
        is_early = begin_s < self._due_at_s and not at_once
        if not is_edited and (is_early or self.ledger.seq == self._published_seq):
            return False
        page = self._history.build_page(self._edits.notes)
        if self._edits.file.put(self._history.render(page)):
            self._published_seq = self.ledger.seq
        publish(self._workspace.log, self._log.render(self.ledger.seq))
        cost_s = self._clock.now_s() - begin_s
        self._due_at_s = begin_s + max(self._period_s, cost_s / SHARE)
        return True

    def close(self) -> None:
        """Publish what is still due, take in what came out, and let go of the journal."""
        for _ in range(CLOSING_TURNS):
            if not self.refresh(at_once=True):
                break
        self._history.close()
