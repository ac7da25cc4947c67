"""Positions of the records of each session, goal and node: an index over sealed segments, which never change.

`.cache/<partition>.sqlite` is a cache and may be deleted any time: what is missing is read again from the segments, and
what does not fit them is discarded.
"""

import contextlib
import os
import sqlite3
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.store import segments
from phyagentos.store.records import iter_places

_CRC_MASK = 0xFFFFFFFF
_ROTTEN = (sqlite3.Error, OSError, TypeError, ValueError)  # what reading a file of arbitrary bytes may raise
_BUFFER_BYTES = 2**20
_WAIT_S = 30.0  # while another process reads segments in
_SCHEMA = """
CREATE TABLE IF NOT EXISTS segment
    (number INTEGER PRIMARY KEY, name TEXT, bytes INTEGER, last_seq INTEGER, crc INTEGER);
CREATE TABLE IF NOT EXISTS place (id TEXT, segment INTEGER, spots TEXT, PRIMARY KEY (id, segment)) WITHOUT ROWID;
"""

# always a row, with how far the index goes: one statement is one look at one state of the file
_FIND = """
SELECT (SELECT last_seq FROM segment ORDER BY number DESC LIMIT 1), segment.name, spots
FROM (SELECT 1) LEFT JOIN place ON place.id = ? LEFT JOIN segment ON segment.number = place.segment
ORDER BY place.segment
"""


class CacheFile:
    """A cache in one SQLite file, opened at first use, that may be deleted any time: its owner computes it again.

    The owner takes care that one thread uses it at a time. `schema` are the statements that open it, `wait_s` the
    longest wait for another process that writes [s]; `check` raises `sqlite3.Error` for contents that are not as they
    were written.
    """

    def __init__(
        self, path: Path, schema: str, *, wait_s: float, check: Callable[[sqlite3.Connection], None] | None = None
    ) -> None:
        self.path = path
        self._schema, self._wait_s, self._check = f"PRAGMA journal_mode = WAL; {schema}", wait_s, check
        self._connection: sqlite3.Connection | None = None

    def connect(self) -> sqlite3.Connection:
        """The open file; raises `sqlite3.Error` or OSError where it cannot be used."""
        if self._connection is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(self.path, timeout=self._wait_s, isolation_level=None, check_same_thread=False)
            try:
                connection.executescript(self._schema)
                if self._check is not None:
                    self._check(connection)
            except BaseException:
                connection.close()
                raise
            self._connection = connection
        return self._connection

    def close(self) -> None:
        """Close the file."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def discard(self) -> None:
        """Close and delete the file."""
        with contextlib.suppress(sqlite3.Error):
            self.close()
        self._connection = None
        for suffix in ("", "-wal", "-shm"):
            with contextlib.suppress(OSError):
                self.path.with_name(self.path.name + suffix).unlink(missing_ok=True)


class RecordPosition(NamedTuple):
    """Position of one record."""

    segment: str
    offset: int
    length: int


class _Segment(NamedTuple):
    number: int
    name: str
    bytes: int
    last_seq: int


class HistoryIndex(CacheFile):
    """The index of one partition `sessions/<partition>`; each process opens its own.

    Records up to `last_seq` are in it, as far as this process has read; they end with `last_segment`, empty for none.
    Methods raise ExecutionError: `INDEX_UNAVAILABLE`, `JOURNAL_DAMAGED`.
    """

    def __init__(self, folder: Path) -> None:
        self.last_seq, self.last_segment = 0, ""
        self._folder = folder
        path = folder.parent.parent / ".cache" / f"{folder.name}.sqlite"
        super().__init__(path, _SCHEMA, wait_s=_WAIT_S, check=_check)

    def extend(self) -> None:
        """Read every sealed segment that is not in it yet."""
        for is_last_try in (False, True):
            try:
                self._extend(self.connect())
            except _ROTTEN as error:
                self.discard()
                if is_last_try:
                    raise ExecutionError("INDEX_UNAVAILABLE", f"{self.path}: {error}. Delete it.") from error
            else:
                return

    def find(self, id: str) -> list[RecordPosition]:
        """Positions of the indexed records of an id, oldest first."""
        try:
            return self._find(id)
        except _ROTTEN:
            self.rebuild()
            return self._find(id)

    def rebuild(self) -> None:
        """Discard it and read every sealed segment again."""
        self.discard()
        self.extend()

    def _find(self, id: str) -> list[RecordPosition]:
        connection = self.connect()
        rows = connection.execute(_FIND, (id,)).fetchall()
        if (rows[0][0] or 0) < self.last_seq:  # another process began it anew
            self._extend(connection)
            rows = connection.execute(_FIND, (id,)).fetchall()
        return [
            RecordPosition(name, *map(int, spot.split(":")))
            for _, name, spots in rows
            if name
            for spot in spots.split(" ")
        ]

    @override
    def discard(self) -> None:
        super().discard()
        self.last_seq, self.last_segment = 0, ""

    def _extend(self, connection: sqlite3.Connection) -> None:
        last = self._find_last(connection)
        name = self._find_sealed(last)
        while name is not None:
            with _transaction(connection):
                now = self._find_last(connection)  # another process may have been faster
                if now == last:
                    now = self._read_in(connection, name, (last.number if last else 0) + 1)
            last = now
            name = self._find_sealed(last)
        self.last_seq, self.last_segment = (last.last_seq, last.name) if last else (0, "")

    def _find_last(self, connection: sqlite3.Connection) -> _Segment | None:
        """The latest segment in it; nothing is left in it when that is not the segment as it stands."""
        row = connection.execute(
            "SELECT number, name, bytes, last_seq FROM segment ORDER BY number DESC LIMIT 1"
        ).fetchone()
        if row is None:
            return None
        last = _Segment(*row)
        with (
            contextlib.suppress(FileNotFoundError),
            os.fdopen(segments.open_segment(self._folder, last.name), "rb") as file,
        ):
            if os.fstat(file.fileno()).st_size == last.bytes:
                return last
        connection.execute("DELETE FROM segment")
        connection.execute("DELETE FROM place")
        return None

    def _find_sealed(self, last: _Segment | None) -> str | None:
        """The first sealed segment behind the last one in it."""
        if last is None:
            names = segments.list_all_segments(self._folder)
            return names[0] if len(names) > 1 else None
        name = segments.find_next_segment(self._folder, last.name)
        return name if name is not None and segments.find_next_segment(self._folder, name) is not None else None

    def _read_in(self, connection: sqlite3.Connection, name: str, number: int) -> _Segment:
        spots: dict[str, str] = {}  # one text an id: the supervisor keeps what it takes here at most
        with os.fdopen(segments.open_segment(self._folder, name), "rb", buffering=_BUFFER_BYTES) as file:
            front = segments.read_front(self._folder / f"{name}.md", file.read(segments.FRONT_MAX_BYTES))
            last_seq, end = front.first_seq - 1, len(front.encode())
            file.seek(end)
            for id, seq, offset, length in iter_places(file):
                spots[id] = f"{spots[id]} {offset}:{length}" if id in spots else f"{offset}:{length}"
                last_seq, end = seq, offset + length
            size = os.fstat(file.fileno()).st_size
        if end != size:
            what = f"record {last_seq + 1} is not as it was written"
            raise segments.damage(segments.locate(self._folder, name), end, what)
        connection.executemany("INSERT INTO place VALUES (?, ?, ?)", ((id, number, text) for id, text in spots.items()))
        row = _Segment(number, name, size, last_seq)
        crc = sum((_compute_crc((id, number, text)) for id, text in spots.items()), _compute_crc(row)) & _CRC_MASK
        connection.execute("INSERT INTO segment VALUES (?, ?, ?, ?, ?)", (*row, crc))
        return row


def _check(connection: sqlite3.Connection) -> None:
    """Hold every row against the sums, once a process: a row that has rotted away would make a used id look new."""
    with _transaction(connection, "DEFERRED"):
        expected, found = {}, {}
        for *row, crc in connection.execute("SELECT number, name, bytes, last_seq, crc FROM segment"):
            expected[row[0]], found[row[0]] = crc, _compute_crc(row)
        for segment, row in connection.execute("SELECT segment, id || ' ' || segment || ' ' || spots FROM place"):
            found[segment] = found.get(segment, 0) + zlib.crc32(str(row).encode())
    if {number: total & _CRC_MASK for number, total in found.items()} != expected:
        raise sqlite3.DatabaseError("its rows are not as they were written")


def _compute_crc(row: Iterable[object]) -> int:
    return zlib.crc32(" ".join(map(str, row)).encode())


@contextlib.contextmanager
def _transaction(connection: sqlite3.Connection, kind: str = "IMMEDIATE") -> Iterator[None]:
    connection.execute(f"BEGIN {kind}")
    try:
        yield
    except BaseException:
        connection.execute("ROLLBACK")
        raise
    connection.execute("COMMIT")
