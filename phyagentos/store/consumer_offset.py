"""What a journal's owner has not read yet, in bounded memory.

Records of an owner that keeps up are handed over from memory, each parsed once; a slow or new owner is remembered as a
place in the journal and reads from there.
"""

from collections.abc import Sequence
from pathlib import Path

from phyagentos.store.follower import Follower, Position
from phyagentos.store.records import Record

UNREAD_KEPT = 4096  # records; more are read again from the segments


class ConsumerOffset:
    """The owner's place in a partition; `delivered` is where it stands as of its last call, None before the first."""

    def __init__(self, folder: Path) -> None:
        self.delivered: Position | None = None
        self._folder = folder
        self._unread: list[Record] = []
        self._behind: Follower | None = Follower(folder)

    def begin_at(self, position: Position | None) -> None:
        """Let the owner go on there, whatever it has read so far; None is before the first record."""
        self.close()
        self.delivered, self._unread = position, []
        self._behind = Follower(self._folder, position)

    def add(self, records: Sequence[Record]) -> None:
        """Records that the journal's cursor has passed."""
        if self._behind is None:
            self._unread += records
            if len(self._unread) > UNREAD_KEPT and self.delivered is not None:
                self._unread = []
                self._behind = Follower(self._folder, self.delivered)

    def take(self, cursor: Follower) -> tuple[list[Record], Follower]:
        """What the owner has not read, and the cursor to go on with; the given one has just read as far as it can."""
        if self._behind is None:
            records, self._unread = self._unread, []
        else:
            records = self._behind.read_new()
            if self._behind.seq >= cursor.seq:
                cursor.close()
                cursor, self._behind = self._behind, None
        if records or self.delivered is None:
            self.delivered = cursor.position
        return records, cursor

    def close(self) -> None:
        """Close the files."""
        if self._behind is not None:
            self._behind.close()
