"""The run of a suite as a grid: a row for each task and setting, a column for each seed, a cell for each episode."""

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from pathlib import Path

from phyagentos.bench.episode import WORKSPACE
from phyagentos.bench.records import AXES, LOG, Axes, EpisodeRecord, read_records
from phyagentos.bench.sweep import MANIFEST, Manifest, read_manifest
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.regular_files import UnfitFileError
from phyagentos.view.places import PLAIN, Place

CELLS_MAX = 5000
FILE_MAX = 64 << 20  # bytes of the records of a run
TEXT_MAX = 300  # letters of why an episode ended so
_EPISODES = "episodes"


class Standing(StrEnum):
    """How an episode stands."""

    MET = "met"
    """Met, as the scorer says, and without a second try."""
    AGAIN = "met after replans"
    """Met after a replan."""
    FAILED = "not met"
    """Scorer and verdict agree."""
    FALSE_SUCCESS = "false success"
    """The verdict is a success, or that of a session is, and the scorer denies it."""
    FALSE_FAILURE = "false failure"
    """The scorer sees a success that the verdict denies."""
    UNSCORED = "not scored"
    """The scorer could not say."""
    BROKEN = "broken off"
    """It hung, or its process died."""
    RUNNING = "running"
    """Begun, and a process works on the run."""
    WAITING = "waiting"
    """Not begun, or to be begun again."""
    MISSING = "missing"
    """This machine cannot run it."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One episode; `folder` is its own below `episodes/`, empty before it has one."""

    standing: Standing
    text: str
    folder: str


def read_grid(place: Place) -> Fields:
    """Values of the template `grid`; raises DefinitionError `CHANGED`, `NOT_A_WORKSPACE`, and OSError."""
    manifest, records = read_run(place)
    shown = manifest.orders[:CELLS_MAX]
    rows: dict[str, dict[int, Cell]] = {}
    begun, is_running = _find_begun(place.root), place.is_running
    for order in shown:
        record = records.get(order.id)
        cell = _show_record(record) if record else _show_order(order, manifest, begun, is_running=is_running)
        rows.setdefault(_name_row(order), {})[order.seed] = cell
    return {
        "place": place,
        "rows": rows,
        "seeds": sorted({order.seed for order in shown}),
        "counts": Counter(cell.standing for row in rows.values() for cell in row.values()),
        "left_out": len(manifest.orders) - len(shown),
        "standings": list(Standing),
    }


def read_run(place: Place) -> tuple[Manifest, dict[str, EpisodeRecord]]:
    """What a run is, and its records so far by episode, read again where they have changed."""
    return _read_run(place.root, tuple(_stamp(place.root / name) for name in (MANIFEST, LOG)))


def find_episode(place: Place, folder: str) -> Path:
    """The workspace of an episode, by its folder's name; raises OSError where there is none within the run."""
    root = place.root / _EPISODES / folder / WORKSPACE
    if not PLAIN.fullmatch(folder) or root.resolve() != place.root / _EPISODES / folder / WORKSPACE:
        raise UnfitFileError(f"no episode {folder!r} in {place.name}")
    return root


@lru_cache(maxsize=32)
def _read_run(root: Path, _: tuple[tuple[int, int], ...]) -> tuple[Manifest, dict[str, EpisodeRecord]]:
    return read_manifest(root), {record.id: record for record in read_records(root)}


def _stamp(path: Path) -> tuple[int, int]:
    """When a file was written last, and its size; raises `UnfitFileError` for a link, and for more than is read."""
    if path.is_symlink():
        raise UnfitFileError(f"{path} is a link; only regular files are read")
    found = path.stat() if path.exists() else None
    if found is not None and found.st_size > FILE_MAX:
        raise UnfitFileError(f"{path} has {found.st_size} bytes; at most {FILE_MAX} are read")
    return (found.st_mtime_ns, found.st_size) if found is not None else (0, 0)


def _find_begun(root: Path) -> dict[str, str]:
    """Id of an episode -> the name of its latest folder."""
    try:
        names = sorted(path.name for path in (root / _EPISODES).iterdir())
    except OSError:
        return {}
    return {name.rpartition("-")[0]: name for name in names}


def _name_row(axes: Axes) -> str:
    return " ".join(value for axis in AXES if (value := str(getattr(axes, axis))))


def _show_record(record: EpisodeRecord) -> Cell:
    if record.ended != "over":
        standing = Standing.BROKEN
    elif record.is_false_success or record.is_false_failure:
        standing = Standing.FALSE_SUCCESS if record.is_false_success else Standing.FALSE_FAILURE
    elif record.is_met is None:
        standing = Standing.UNSCORED
    elif record.is_met:
        standing = Standing.AGAIN if record.replans else Standing.MET
    else:
        standing = Standing.FAILED
    why = record.error.strip().rpartition("\n")[2] or record.reason
    return Cell(standing, f"{record.verdict or record.ended} {why}"[:TEXT_MAX], Path(record.folder).name)


def _show_order(order: Axes, manifest: Manifest, begun: dict[str, str], *, is_running: bool) -> Cell:
    if order.id in manifest.missing:
        why = "; ".join(f"{each.code} {each.found}" for each in manifest.missing[order.id])
        return Cell(Standing.MISSING, why[:TEXT_MAX], "")
    folder = begun.get(order.id, "")
    return Cell(Standing.RUNNING if folder and is_running else Standing.WAITING, "", folder)
