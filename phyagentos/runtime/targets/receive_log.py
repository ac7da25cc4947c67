"""The target's own receive log: what arrived, what was done with it, and every write of simulator state.

Upstream: `world`, which alone writes it. Downstream: whoever must prove silence. One JSON object a line.
"""

from pathlib import Path
from typing import IO

import msgspec


class Reception(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One line.

    Attributes:
        time_s: Simulated time of arrival [s].
        kind: Name of the request; `state_write` for a write of simulator state.
        accepted: Whether it was carried out.
        code: Why not.
    """

    time_s: float
    kind: str
    episode: str = ""
    session: str = ""
    epoch: int = 0
    sequence: int = 0
    accepted: bool = True
    code: str = ""


class ReceiveLog:
    """Appends to one file; without a path it keeps nothing."""

    def __init__(self, path: Path | None) -> None:
        self._file: IO[bytes] | None = path.open("ab") if path is not None else None
        self._encoder = msgspec.json.Encoder()

    def note(self, reception: Reception) -> None:
        """Append one line."""
        if self._file is not None:
            self._file.write(self._encoder.encode(reception) + b"\n")

    def flush(self) -> None:
        """Hand what was noted to the operating system."""
        if self._file is not None:
            self._file.flush()

    def close(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
