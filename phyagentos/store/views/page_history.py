"""The fold behind a view, and the way back: what SESSIONS.md showed at an earlier record is the base of an edit.

The latest renderings are remembered as the statuses they showed; an older one is folded anew from the journal, where
that is small or its checkpoint older still.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from phyagentos.errors import ExecutionError
from phyagentos.store.checkpoint import start_reading
from phyagentos.store.follower import Follower
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record
from phyagentos.store.segments import list_all_segments, locate
from phyagentos.store.views.sessions import Cache, Page, build_page, render_page

SMALL_BYTES = 8 << 20  # a journal up to this size is read from its first record, in a fraction of a second
PAGES_KEPT = 1000  # renderings: minutes at five a second


class History:
    """Follows a journal and remembers what the latest renderings showed.

    `on_record` is called with each record, once it is applied.
    """

    def __init__(self, partition: Path, *, on_record: Callable[[Record, Ledger], None] | None = None) -> None:
        self._partition = partition
        self.ledger, self._follower = _begin(partition)
        self._on_record = on_record
        self._follow: Callable[[], None] | None = None  # of the owner of a shared fold
        self._reported_seq = 0
        self._texts: Cache = {}
        self._pages: dict[int, Page] = {}  # by record, the oldest first

    def share(self, ledger: Ledger, follow: Callable[[], None]) -> None:
        """Use the fold of another owner in this thread, so that no record is read and applied twice.

        `follow` brings it up to date; it calls `take_in` with each record it applies.
        """
        follow()
        self.read_new()  # at least as far as the fold of the other
        self._follower.close()
        self._reported_seq, self.ledger, self._follow = self.ledger.seq, ledger, follow

    def take_in(self, record: Record) -> None:
        """A record was applied to the shared fold."""
        if self._follow is not None and record.seq > self._reported_seq and self._on_record is not None:
            self._on_record(record, self.ledger)

    def read_new(self) -> int:
        """Take in the records since the last call and return their number; raises `JOURNAL_DAMAGED`."""
        if self._follow is not None:
            before = self.ledger.seq
            self._follow()
            return self.ledger.seq - before
        records = self._follower.read_new()
        for record in records:
            self.ledger.apply(record)
            if self._on_record is not None:
                self._on_record(record, self.ledger)
        return len(records)

    def close(self) -> None:
        """Close the journal."""
        if self._follow is None:
            self._follower.close()

    def build_page(self, notes: Sequence[str] = ()) -> Page:
        """What is to be shown now; it is remembered."""
        page = self._pages[self.ledger.seq] = build_page(self.ledger, notes)
        if len(self._pages) > PAGES_KEPT:
            del self._pages[next(iter(self._pages))]
        return page

    def render(self, page: Page) -> str:
        """SESSIONS.md as of a page; sessions that stand as they were rendered last are not rendered again."""
        is_present = page.seq == self.ledger.seq
        return render_page(page, self._texts if is_present else dict(self._texts))

    def find_page(self, seq: int) -> Page | None:
        """What was shown at record `seq`; None when the journal has not come so far, or it is too far back."""
        if seq >= self.ledger.seq:
            return build_page(self.ledger) if seq == self.ledger.seq else None
        if seq in self._pages:
            return self._pages[seq]
        return self._read_again(seq) if seq > 0 else build_page(Ledger())

    def _read_again(self, seq: int) -> Page | None:
        ledger, follower = _begin(self._partition)
        try:
            if ledger.seq > seq:
                return None
            for record in follower.read_new() if ledger.seq < seq else ():
                if record.seq > seq:
                    break
                ledger.apply(record)
        except ExecutionError:
            return None
        finally:
            follower.close()
        return build_page(ledger) if ledger.seq == seq else None


def _begin(partition: Path) -> tuple[Ledger, Follower]:
    """From the first record where that is soon done, else from the checkpoint."""
    names = list_all_segments(partition)
    sizes = (path.stat().st_size for name in names if (path := locate(partition, name)).exists())
    return (Ledger(), Follower(partition)) if sum(sizes) <= SMALL_BYTES else start_reading(partition)
