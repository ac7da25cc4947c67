"""The cache of memory: what was computed from its records, and a full-text index of the lessons.

`.cache/memory-<partition>.sqlite` may be deleted; a missing, damaged or outdated one is made again from the records.
"""

import contextlib
import sqlite3
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import msgspec

from phyagentos.agent.memory.experience import Experience
from phyagentos.agent.memory.experience_log import LogPosition
from phyagentos.agent.memory.methodological import Correction
from phyagentos.store.cache_file import CacheFile

VERSION = 3  # of what stands in it: another one is thrown away
_ANY = "any"  # of a lesson that no skill, or no thing, narrows
_WAIT_S = 10.0
_SCHEMA = """
PRAGMA synchronous = OFF;
CREATE TABLE IF NOT EXISTS state (version INTEGER, place BLOB, experience BLOB, crc INTEGER);
CREATE VIRTUAL TABLE IF NOT EXISTS lesson
    USING fts5 (id UNINDEXED, skill, things, words, tokenize = "unicode61 tokenchars '_'");
"""
_ROTTEN = (sqlite3.Error, OSError, msgspec.MsgspecError, TypeError, ValueError)


class LessonIndex(CacheFile):
    """The cache of one experience log."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, _SCHEMA, wait_s=_WAIT_S)

    def load(self) -> tuple[Experience, LogPosition] | None:
        """What was saved last, None when there is nothing valid."""
        try:
            row = self.connect().execute("SELECT version, place, experience, crc FROM state").fetchone()
            if row is None:
                return None
            if row[0] != VERSION or _compute_crc(row[1], row[2]) != row[3]:
                raise sqlite3.DatabaseError("it is not what was written, or of another version")
            return msgspec.json.decode(row[2], type=Experience), msgspec.json.decode(row[1], type=LogPosition)
        except _ROTTEN:
            self.discard()
            return None

    def save(self, experience: Experience, place: LogPosition, changed: Iterable[str] | None) -> None:
        """Save what was computed up to a place; `changed` None means all entries. A failure only costs the cache."""
        try:
            connection = self.connect()
            with contextlib.closing(connection.cursor()) as cursor:
                cursor.execute("BEGIN IMMEDIATE")
                cursor.execute("DELETE FROM state")
                encoded = msgspec.json.encode(place), msgspec.json.encode(experience)
                cursor.execute("INSERT INTO state VALUES (?, ?, ?, ?)", (VERSION, *encoded, _compute_crc(*encoded)))
                _write_lessons(cursor, experience.corrections, changed)
                cursor.execute("COMMIT")
        except _ROTTEN:
            self.discard()

    def find(self, skill: str, words: Iterable[str], limit: int) -> list[str] | None:
        """Ids of lessons about a skill (empty for any) and any of the words, the best match first.

        None where the index cannot answer.
        """
        wanted = " OR ".join(_quote(word) for word in dict.fromkeys(words) if word.strip())
        parts = [f"skill: ({_quote(skill)} OR {_quote(_ANY)})"] if skill else []
        or_general = f" OR {{things}}: {_quote(_ANY)}" if skill else ""
        parts += [f"({{things words}}: ({wanted}){or_general})"] if wanted else []
        if not parts:
            return None
        query = "SELECT id FROM lesson WHERE lesson MATCH ? ORDER BY bm25(lesson, 1.0, 4.0, 4.0, 1.0), id LIMIT ?"
        try:
            return [row[0] for row in self.connect().execute(query, (" AND ".join(parts), limit))]
        except _ROTTEN:
            return None


def _write_lessons(
    cursor: sqlite3.Cursor, corrections: Mapping[str, Correction], changed: Iterable[str] | None
) -> None:
    if changed is None:
        cursor.execute("DELETE FROM lesson")
        changed = corrections.keys()
    else:
        known = {row[0] for row in cursor.execute("SELECT id FROM lesson")}
        changed = {*changed, *(known - corrections.keys()), *(corrections.keys() - known)}
        cursor.executemany("DELETE FROM lesson WHERE id = ?", [(id,) for id in changed])
    cursor.executemany(
        "INSERT INTO lesson VALUES (?, ?, ?, ?)", [_to_row(corrections[id]) for id in changed if id in corrections]
    )


def _to_row(correction: Correction) -> tuple[str, str, str, str]:
    scope = correction.where
    is_open = not (scope.object or scope.destination or scope.entities)
    things = " ".join(filter(None, (scope.object, scope.destination, scope.scene, *scope.entities, _ANY * is_open)))
    words = " ".join((correction.cause, correction.objective, correction.note, *sorted(correction.advice.changed)))
    return correction.id, scope.skill or _ANY, things, words


def _compute_crc(place: bytes, experience: bytes) -> int:
    return zlib.crc32(experience, zlib.crc32(place))


def _quote(word: str) -> str:
    return '"' + word.replace('"', '""') + '"'
