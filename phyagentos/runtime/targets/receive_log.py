"""The target's own receive log: what arrived, what was done with it, and every write of simulator state.

Upstream: `world`, which alone writes it. Downstream: whoever must prove silence. One JSON object a line, handed to the
operating system at once, so that a target that is killed leaves all that it accepted.
"""

import contextlib
import os
from pathlib import Path

import msgspec

from phyagentos.clock import Clock

PROCESS_START = "process_start"  # a target that knows of no earlier authority begins to write
STATE_WRITE = "state_write"
UNTOLD = "the receive log cannot be written; what cannot be told must not be done"


class Reception(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One line.

    Attributes:
        time_s: Simulated time when it had been dealt with [s].
        kind: Name of the request; `state_write` for a write of simulator state; `process_start` once a process.
        accepted: Whether it was carried out.
        code: Why not.
        at: UTC wall time of arrival, by the clock that also stamps the journal; empty without a clock. No part of any
            evidence.
    """

    time_s: float
    kind: str
    episode: str = ""
    session: str = ""
    epoch: int = 0
    sequence: int = 0
    accepted: bool = True
    code: str = ""
    at: str = ""


class ReceiveLog:
    """Appends to one file; without a path it keeps nothing.

    Args:
        path: The file; what it holds already stays.
        clock: Stamps the lines.
    """

    def __init__(self, path: Path | None, clock: Clock | None = None) -> None:
        self._clock = clock
        self._encoder = msgspec.json.Encoder()
        self._arrived_at = ""
        self._unwritten = b""
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644) if path else -1
        if path is not None:
            self._end_torn_line()
            self.stamp()
            self.note(Reception(time_s=0.0, kind=PROCESS_START))

    def stamp(self) -> None:
        """A request arrives now; what is noted until the next one carries this time."""
        self._arrived_at = self._clock.wall_iso() if self._clock is not None else ""

    def note(self, reception: Reception) -> None:
        """Append one line; kept in memory while the disk takes no more."""
        if self._fd >= 0:
            stamped = msgspec.structs.replace(reception, at=self._arrived_at)
            self._unwritten += self._encoder.encode(stamped) + b"\n"
            self._write()

    @property
    def is_behind(self) -> bool:
        """Whether lines could not be written; see `UNTOLD`."""
        if self._unwritten:
            self._write()
        return bool(self._unwritten)

    def close(self) -> None:
        """Let go of the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _end_torn_line(self) -> None:
        """A process that found the disk full, or lost its power, may have left half a line."""
        size = os.fstat(self._fd).st_size
        if size and os.pread(self._fd, 1, size - 1) != b"\n":
            self._unwritten = b"\n"

    def _write(self) -> None:
        with contextlib.suppress(OSError):
            while self._unwritten:
                self._unwritten = self._unwritten[os.write(self._fd, self._unwritten) :]
