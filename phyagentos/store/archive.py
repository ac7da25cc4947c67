"""The archive: sealed segments that nothing live or unfinished needs any more, out of the way but never deleted.

Upstream: the writer of a checkpoint. Downstream: followers, which look there for what is no longer in the
lane. A segment moves from `sessions/<lane>/` to `sessions/archive/<yyyy-mm>/<lane>/`, month of its name, unchanged: one
rename within the file system, oldest first, so that the archived ones always precede those in the lane. A death between
two steps leaves each segment in one place or the other. Order of the steps: make the folders durable, rename, make the
new name durable, then the absence of the old one; after a power cut a name may stand in both places (the archived file
counts, both are the same file) and never in none.
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
    """Move every segment whose records all come before a horizon.

    Args:
        folder: Of the lane.
        horizon_seq: First record of anything that is live or not over (`Ledger.find_horizon`).
        known_seq: Last record that the horizon takes into account.
        file_io: The calls that change the disk.
        durable: Whether to wait for the disk.

    Returns:
        Names of those that were moved, oldest first.

    Raises:
        OSError: The rest stays where it is.
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
