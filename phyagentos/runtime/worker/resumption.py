"""Where the latest session of an episode left its world: a simulated one that begins anew is put there again."""

import contextlib
from dataclasses import dataclass
from glob import escape
from pathlib import Path

import msgspec

from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, INITIAL, OWN_SNAPSHOTS, TERMINAL
from phyagentos.protocol.world.environment import Environment


@dataclass(frozen=True, slots=True)
class Left:
    """A recorded moment of a world [s], and the file with the target's own snapshot of it."""

    time_s: float
    snapshot: Path


def find_left(evidence: Path, episode: str) -> Left | None:
    """The latest recorded moment of an episode, of whatever target; None without one."""
    found = [
        Left(belief.time_s, snapshot)
        for folder in evidence.glob(f"{escape(episode)}.*")
        for seen, name in ((BEFORE, INITIAL), (AFTER, TERMINAL))
        for snapshot in (folder / name, folder / OWN_SNAPSHOTS[name])
        if snapshot.is_file() and (belief := read_belief(folder, seen)) is not None
    ]
    return max(found, key=lambda each: each.time_s, default=None)


def read_belief(folder: Path, seen: str = BEFORE) -> Environment | None:
    """The belief at the start of a session, or after it, from its bundle; None where its writer could not finish it."""
    with contextlib.suppress(msgspec.DecodeError, OSError):
        return msgspec.json.decode((folder / seen).read_bytes(), type=Environment)
    return None
