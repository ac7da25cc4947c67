"""The cache of memory: what was computed from its records, in one file that may be deleted any time.

A missing, damaged or outdated one is made again from the records.
"""

import contextlib
import zlib
from pathlib import Path

import msgspec

from phyagentos.agent.memory.experience import Experience
from phyagentos.agent.memory.experience_log import LogPosition
from phyagentos.protocol.documents.markdown import publish

VERSION = 5  # of what stands in it: another one is thrown away


class _Saved(msgspec.Struct, frozen=True):
    """The content of the file.

    Attributes:
        crc: Of `experience`.
    """

    version: int
    crc: int
    place: LogPosition
    experience: msgspec.Raw


class MemoryCache:
    """The cache of one experience log."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self) -> tuple[Experience, LogPosition] | None:
        """What was saved last, None when there is nothing valid."""
        with contextlib.suppress(OSError, msgspec.MsgspecError, ValueError):
            saved = msgspec.json.decode(self.path.read_bytes(), type=_Saved)
            if saved.version == VERSION and zlib.crc32(saved.experience) == saved.crc:
                return msgspec.json.decode(saved.experience, type=Experience), saved.place
        return None

    def save(self, experience: Experience, place: LogPosition) -> None:
        """Save what was computed up to a place; a failure only costs the cache."""
        encoded = msgspec.Raw(msgspec.json.encode(experience))
        saved = _Saved(version=VERSION, crc=zlib.crc32(encoded), place=place, experience=encoded)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            publish(self.path, msgspec.json.encode(saved).decode())
        except OSError:
            self.discard()

    def discard(self) -> None:
        """Delete the file."""
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)
