"""The run of a suite as a grid: a row for each task and setting, a column for each seed, a cell for each episode."""

import os
import stat
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from textwrap import shorten

from phyagentos.bench.episode import WORKSPACE
from phyagentos.bench.records import AXES, LOG, EpisodeRecord, read_records
from phyagentos.bench.report import Rate
from phyagentos.bench.suite_file import Suite, read_suite
from phyagentos.bench.sweep import MANIFEST, SUITE, Manifest, read_manifest
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.regular_files import UnfitFileError
from phyagentos.view.places import PLAIN, Place

CELLS_MAX = 5000
FILE_MAX = 64 << 20  # bytes of the records of a run
TEXT_MAX = 300  # letters of why an episode ended so
UNMET_SHOWN = 20  # episodes with their reasons
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
    manifest, records, suite = _read_run(place.root, *(_stamp(place.root / name) for name in (MANIFEST, LOG, SUITE)))
    begun = {path.name.rpartition("-")[0]: path.name for path in sorted(place.root.glob(f"{_EPISODES}/*"))}
    shown, is_running = manifest.orders[:CELLS_MAX], place.is_running
    rows: dict[str, dict[int, Cell]] = {}
    met, unmet = Counter[str](), list[tuple[str, int, Cell]]()
    for order in shown:
        name = " ".join(value for axis in AXES if (value := getattr(order, axis)))
        folder = begun.get(order.id, "")
        cell = _show(manifest.missing.get(order.id, ()), records.get(order.id), folder, is_running=is_running)
        rows.setdefault(name, {})[order.seed] = cell
        if (record := records.get(order.id)) is not None:
            met[name] += bool(record.is_met)
            unmet += [(name, order.seed, cell)] * (not record.is_met)
    every = records.values()
    return {
        "place": place,
        "suite": suite,
        "rate": Rate(sum(bool(each.is_met) for each in every), len(every)),
        "wall_s": sum(each.wall_s for each in every),
        "met": met,
        "unmet": unmet[:UNMET_SHOWN],
        "more_unmet": len(unmet[UNMET_SHOWN:]),
        "rows": rows,
        "seeds": sorted({order.seed for order in shown}),
        "counts": Counter(cell.standing for row in rows.values() for cell in row.values()),
        "left_out": len(manifest.orders) - len(shown),
        "standings": list(Standing),
    }


def find_episode(place: Place, folder: str) -> Path:
    """The workspace of an episode, by its folder's name; raises OSError where there is none within the run."""
    root = place.root / _EPISODES / folder / WORKSPACE
    if not PLAIN.fullmatch(folder) or root.resolve() != root:
        raise UnfitFileError(f"no episode {folder!r} in {place.name}")
    return root


@lru_cache(maxsize=32)
def _read_run(root: Path, *_: tuple[int, int]) -> tuple[Manifest, dict[str, EpisodeRecord], Suite | None]:
    suite = None
    with suppress(DefinitionError):  # the run stands without its words
        suite = read_suite(root / SUITE)[0]
    return read_manifest(root), {record.id: record for record in read_records(root)}, suite


def _stamp(path: Path) -> tuple[int, int]:
    """When a file was written last, and its size; raises OSError for a link, and for more than is read."""
    found = path.lstat() if os.path.lexists(path) else path.parent.lstat()
    if stat.S_ISLNK(found.st_mode) or found.st_size > FILE_MAX:
        raise UnfitFileError(f"{path}: only regular files of at most {FILE_MAX} bytes are read")
    return found.st_mtime_ns, found.st_size


def _show(missing: Sequence[Problem], record: EpisodeRecord | None, folder: str, *, is_running: bool) -> Cell:
    if record is None:
        standing = Standing.MISSING if missing else Standing.RUNNING if folder and is_running else Standing.WAITING
        return Cell(standing, "; ".join(f"{each.code} {each.found}" for each in missing)[:TEXT_MAX], folder)
    found = {
        Standing.BROKEN: record.ended != "over",
        Standing.FALSE_SUCCESS: record.is_false_success,
        Standing.FALSE_FAILURE: record.is_false_failure,
        Standing.UNSCORED: record.is_met is None,
        Standing.FAILED: not record.is_met,
        Standing.AGAIN: bool(record.replans),
    }
    why = record.error.strip().rpartition("\n")[2] or record.reason
    text = shorten(f"{record.verdict or record.ended} {why}", TEXT_MAX, placeholder=" …")
    return Cell(next((each for each, holds in found.items() if holds), Standing.MET), text, Path(record.folder).name)
