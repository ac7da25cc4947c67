"""The archive: sealed segments that no live session or open goal needs, moved but never deleted.

A segment moves from `sessions/<lane>/` to `sessions/archive/<yyyy-mm>/<lane>/`, month of its name, by one rename,
oldest first: archived segments always precede those in the lane. Folders are made durable first, then the new
name, then the absence of the old one. After a power cut a name may stand in both places (the archived file counts), never in none.
"""

from itertools import pairwise
from pathlib import Path

from phyagentos.store.segments import (
    FileIO,
    list_segments,
    locate_archived,
    read_front,
    sync_folder,
)

_FRONT_BYTES = 4096


def archive_segments(folder: Path, horizon_seq: int, known_seq: int, file_io: FileIO, *, durable: bool) -> list[str]:
    """Move every segment whose records all come before `horizon_seq`; the names moved, oldest first.

    Args:
        folder: Of the lane.
        horizon_seq: First record of anything that is live or not over (`Ledger.find_horizon`).
        known_seq: Last record that the horizon takes into account.
        file_io: The calls that change the disk.
        durable: Whether to wait for the disk.
    """
    moved: list[str] = []
    names = list_segments(folder)
    for name, later in pairwise(names):  # never the last: it is being written
        last_seq = _read_first_seq(folder / f"{later}.md") - 1
        if last_seq >= horizon_seq or last_seq > known_seq:
            break
        _move(folder / f"{name}.md", locate_archived(folder, name), file_io, durable=durable)
        moved.append(name)
    return moved


def _move(source: Path, destination: Path, file_io: FileIO, *, durable: bool) -> None:
    place = destination.parent
    place.mkdir(parents=True, exist_ok=True)
    if durable:  # their creator may have died before their names reached the disk
        for parent in (place.parent, place.parent.parent, place.parent.parent.parent):
            sync_folder(parent, file_io)
    file_io.replace(source, destination)
    if durable:
        sync_folder(place, file_io)
        sync_folder(source.parent, file_io)


def _read_first_seq(path: Path) -> int:
    with path.open("rb") as file:
        return read_front(path, file.read(_FRONT_BYTES)).first_seq
