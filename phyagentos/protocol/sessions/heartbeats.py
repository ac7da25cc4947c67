"""Heartbeats: one small file per target, replaced as a whole, never part of the journal.

A heartbeat carries progress, which distinguishes a runner that advances from one that only beats.
"""

from pathlib import Path

import msgspec

from phyagentos.protocol.documents.regular_files import REQUEST_MAX, read_regular


class Heartbeat(msgspec.Struct, frozen=True, kw_only=True):
    """What a worker is doing at this moment.

    Attributes:
        target: Whose worker.
        pid: Its process.
        session: What it runs, empty when idle.
        epoch: Of the claim.
        sequence: Grows with each beat.
        tick: Control periods commanded so far.
        sim_time_s: The world's time.
        leaf: Path of the active leaf.
        q_rad: Measured joint positions while it executes [rad, m], in the order of the profile.
        gripper_width_m: Measured opening [m].
        phase: `idle`, `loading`, `executing`, `thinking`, `paused`, `looking` (each beat
            follows a frame), `halting`, `observing`.
    """

    target: str
    pid: int
    session: str = ""
    epoch: int = 0
    sequence: int = 0
    tick: int = 0
    sim_time_s: float = 0.0
    leaf: str = ""
    phase: str = "idle"
    q_rad: tuple[float, ...] = ()
    gripper_width_m: float = 0.0


def write_heartbeat(folder: Path, beat: Heartbeat) -> None:
    """Replace `<target>.json` as a whole."""
    temporary = folder / f".{beat.target}.tmp"
    try:
        temporary.write_bytes(msgspec.json.encode(beat))
        temporary.replace(folder / f"{beat.target}.json")
    except FileNotFoundError:  # the folder was deleted meanwhile; the next beat follows in a tenth of a second
        folder.mkdir(parents=True, exist_ok=True)


def find_heartbeat(folder: Path, target: str) -> Heartbeat | None:
    """The latest beat of a target's worker, or None."""
    try:
        return msgspec.json.decode(read_regular(f"{folder}/{target}.json", REQUEST_MAX, follow=False), type=Heartbeat)
    except (OSError, msgspec.MsgspecError):
        return None


def read_heartbeats(folder: Path) -> dict[str, Heartbeat]:
    """The latest beat of every target's worker, by target."""
    found = (find_heartbeat(folder, path.stem) for path in sorted(folder.glob("*.json")))
    return {beat.target: beat for beat in found if beat is not None}


def is_process_alive(pid: int) -> bool:
    """Whether a process of this machine runs; one that has ended and was not yet collected does not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in {"Z", "X"}  # its name, in parentheses, may hold anything
