"""The target's own receive log: requests, their outcomes, and every write of simulator state.

One JSON object a line, written at once, so that a killed target leaves a record of all that it accepted.
"""

import contextlib
import os
from pathlib import Path

import msgspec

from phyagentos.clock import Clock

PROCESS_START = "process_start"  # this process knows of no earlier authority
STATE_WRITE = "state_write"
LOG_BEHIND = "the receive log cannot be written; what cannot be recorded must not be done"


class Reception(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One line; `time_s` is the simulated time after the request was carried out [s], `code` that of its refusal.

    `kind` is the name of the request, `state_write` for a write of simulator state, or `process_start` once a process;
    `at` the UTC wall time of arrival, by the journal's clock, empty without one and not part of any evidence.
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
    """Appends to one file; without a path it keeps nothing."""

    def __init__(self, path: Path | None, clock: Clock | None = None) -> None:
        self._clock = clock
        self._encoder = msgspec.json.Encoder()
        self._arrived_at = ""
        self._unwritten = b""
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644) if path else -1
        if path is not None:
            size = os.fstat(self._fd).st_size
            if size and os.pread(self._fd, 1, size - 1) != b"\n":  # a full disk or a loss of power leaves half a line
                self._unwritten = b"\n"
            self.stamp()
            self.note(Reception(time_s=0.0, kind=PROCESS_START))

    def stamp(self) -> None:
        """A request arrives now; lines until the next one carry this time."""
        self._arrived_at = self._clock.wall_iso() if self._clock is not None else ""

    def note(self, reception: Reception) -> None:
        """Append one line; kept in memory while the disk takes no more."""
        if self._fd >= 0:
            self._unwritten += self._encoder.encode(msgspec.structs.replace(reception, at=self._arrived_at)) + b"\n"
            self._write()

    @property
    def is_behind(self) -> bool:
        """Whether lines could not be written; see `LOG_BEHIND`."""
        if self._unwritten:
            self._write()
        return bool(self._unwritten)

    def close(self) -> None:
        """Close the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _write(self) -> None:
        with contextlib.suppress(OSError):
            while self._unwritten:
                self._unwritten = self._unwritten[os.write(self._fd, self._unwritten) :]
