"""A cache in one SQLite file, which may be deleted any time."""

import contextlib
import sqlite3
from pathlib import Path


class CacheFile:
    """A cache in one SQLite file, opened at first use, that may be deleted any time: its owner computes it again.

    The owner takes care that one thread uses it at a time. `schema` are the statements that open it, `wait_s` the
    longest wait for another process that writes [s].
    """

    def __init__(self, path: Path, schema: str, *, wait_s: float) -> None:
        self.path = path
        self._schema, self._wait_s = f"PRAGMA journal_mode = WAL; {schema}", wait_s
        self._connection: sqlite3.Connection | None = None

    def connect(self) -> sqlite3.Connection:
        """The open file; raises `sqlite3.Error` or OSError where it cannot be used."""
        if self._connection is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(self.path, timeout=self._wait_s, isolation_level=None, check_same_thread=False)
            try:
                connection.executescript(self._schema)
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
