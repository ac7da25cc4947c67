"""Lanes: one folder below `sessions/` for each host that writes a journal."""

import os
import re
from pathlib import Path

from phyagentos.errors import ExecutionError
from phyagentos.store.segments import ARCHIVE

_NO_LANES = frozenset({ARCHIVE, "claims", "inbox"})


def choose_lane(folder: Path) -> str:
    """Name of the lane below `sessions/` to use: the only one, else this host's; raises `LANE_UNCLEAR`."""
    host = re.sub(r"[^A-Za-z0-9._-]", "-", os.uname().nodename) or "host"
    found = sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
    lanes = [name for name in found if name not in _NO_LANES]
    if host in lanes or not lanes:
        return host
    if len(lanes) == 1:
        return lanes[0]
    raise ExecutionError(
        "LANE_UNCLEAR", f"{folder}: found {', '.join(lanes)}, none of this host ({host}); name a lane."
    )
