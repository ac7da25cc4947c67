"""Leases of a fleet on one host: until when a session that was placed here may command its target.

One small file a session, replaced as a whole, with the end of the lease by the monotonic clock of this host [s]. A
session without a file was submitted on this host and has no such bound.
"""

import math
from pathlib import Path

from phyagentos.protocol.documents.regular_files import REQUEST_MAX, read_regular
from phyagentos.protocol.sessions.session import SessionId

ENDED_S = 0.0  # no clock of this kind stands before it


def write_lease(folder: Path, session: SessionId, until_s: float) -> None:
    """Let a session command until then; raises OSError."""
    temporary = folder / f".{session}.tmp"
    folder.mkdir(parents=True, exist_ok=True)
    temporary.write_text(repr(until_s), encoding="ascii")
    temporary.replace(folder / session)


def read_lease(folder: Path, session: SessionId) -> float:
    """Until when it may command [s]; infinite where nothing bounds it, `ENDED_S` where that cannot be read."""
    try:
        return float(read_regular(folder / session, REQUEST_MAX, follow=False))
    except FileNotFoundError:
        return math.inf
    except (OSError, ValueError):
        return ENDED_S


def remove_lease(folder: Path, session: SessionId) -> None:
    """Forget the lease of a session that is over."""
    (folder / session).unlink(missing_ok=True)
