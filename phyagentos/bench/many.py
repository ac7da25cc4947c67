"""One goal graph with many seeds: a suite of one task, carried out, and read again from its folder.

So `paos bench resume`, `report` and `compare` take the folder, too. Success is the goal's verdict.
"""

import contextlib
import importlib
import json
import re
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import yaml
from msgspec.structs import replace

from phyagentos.assembly.graphics import require_graphics
from phyagentos.assembly.paths import choose_folder
from phyagentos.assembly.project import get_file, open_library, parse_overrides
from phyagentos.bench.engines import EngineName, open_engine
from phyagentos.bench.matrix import compile_suite
from phyagentos.bench.records import AXES, EpisodeRecord, read_records
from phyagentos.bench.report import Rate
from phyagentos.bench.runs import RUNS
from phyagentos.bench.scorers.scorer import VERDICT
from phyagentos.bench.suite_file import Figure
from phyagentos.bench.summary import Comparison
from phyagentos.bench.summary import compare as compare_records
from phyagentos.bench.sweep import SUITE, Manifest, begin_run, continue_run, read_manifest, run_sweep
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.operations.run import RunRequest, check_request
from phyagentos.protocol.documents.schema import parse_yaml
from phyagentos.protocol.predicates.project_predicates import load_predicates
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, PICTURE_BEFORE
from phyagentos.scratch import open_scratch
from phyagentos.wording import count

if TYPE_CHECKING:
    from phyagentos.bench.suite_file import Suite

SHOWN = 8  # failures that a notebook shows with their pictures
WIDTH_PX = 320
FRAMES = ("polars", "pandas")


class ManyRequest(msgspec.Struct, frozen=True, kw_only=True):
    """What is to run, and with which seeds; `settings` changes a new workspace: file -> dotted path -> value."""

    run: RunRequest
    seeds: tuple[int, ...]
    folder: Path | None = None
    settings: Mapping[str, Mapping[str, object]] = {}


@dataclass(frozen=True, slots=True, repr=False)
class Episode:
    """One run; notebooks show its verdict and the pictures of the session that decided."""

    record: EpisodeRecord
    folder: Path

    def __repr__(self) -> str:
        """`<seed 3: failure, red_cube is not inside red_tray>`."""
        return f"<seed {self.seed}: {', '.join(filter(None, (self.verdict, self.reason)))}>"

    @property
    def seed(self) -> int:
        """Root of all its chance."""
        return self.record.seed

    @property
    def verdict(self) -> str:
        """`success`, `failure`, `unverified`; `hung` or `crashed` where its processes came to no verdict."""
        return self.record.verdict or self.record.ended

    @property
    def workspace(self) -> Path:
        """Its workspace, for `open_workspace`."""
        return self.folder / self.record.folder / "workspace"

    @property
    def reason(self) -> str:
        """Why it ended so, in a line."""
        return (self.record.reason or self.record.error).strip().rpartition("\n")[2]

    @property
    def pictures(self) -> tuple[Path, ...]:
        """Before and after its last session that missed its objective, else its last one; none where not rendered."""
        sessions = sorted(self.record.sessions, key=lambda each: bool(each.taxon))
        places = [self.folder / each.bundle / name for each in sessions for name in (PICTURE_BEFORE, PICTURE_AFTER)]
        return tuple(path for path in places[-2:] if path.is_file())

    def _repr_html_(self) -> str:
        from phyagentos.bench.rendering import shrink_picture

        images = "".join(f'<img alt="{path.stem}" src="{shrink_picture(path)}">' for path in self.pictures)
        return f"<p><b>seed {self.seed}</b>: {escape(self.verdict)} {escape(self.reason)}<br>{images}</p>"


class Episodes(tuple[Episode, ...]):
    """Some runs; notebooks show the first of them."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        more = f"<p>… and {len(self) - SHOWN} more</p>" if len(self) > SHOWN else ""
        return "".join(each._repr_html_() for each in self[:SHOWN]) + more


@dataclass(frozen=True, slots=True, repr=False)
class Runs:
    """Many runs, as far as they are; `folder` is what `open_runs` opens again."""

    folder: Path
    episodes: Episodes
    pending: int

    @classmethod
    def open(cls, folder: Path) -> "Runs":
        """As they stand in the folder; raises DefinitionError `NOT_A_WORKSPACE`."""
        manifest, records = read_manifest(folder), sorted(read_records(folder), key=lambda each: each.seed)
        left = len(manifest.orders) - len(manifest.missing.keys() | {each.id for each in records})
        return cls(folder, Episodes(Episode(each, folder) for each in records), left)

    @property
    def rate(self) -> Rate:
        """Goals met among the runs that ended: `successes`, `trials`, `value`, and Wilson's 95 % `interval`."""
        return Rate(sum(bool(each.record.is_met) for each in self.episodes), len(self.episodes))

    @property
    def failures(self) -> Episodes:
        """Runs whose goal was not met, or without a verdict."""
        return Episodes(each for each in self.episodes if not each.record.is_met)

    def rows(self) -> list[dict[str, object]]:
        """A row a run, by the names of columns; times in seconds."""
        axes = [axis for axis in AXES if any(getattr(each.record, axis) for each in self.episodes)]
        return [
            {axis: getattr(each.record, axis) for axis in axes}
            | {"seed": each.seed, "success": bool(each.record.is_met), "verdict": each.verdict, "reason": each.reason}
            | {"kind": each.record.taxon, "sessions": len(each.record.sessions), "replans": each.record.replans}
            | {"sim_time_s": each.record.sim_time_s, "wall_s": each.record.wall_s, "workspace": str(each.workspace)}
            for each in self.episodes
        ]

    def to_frame(self) -> Any:
        """The rows as a data frame of polars, or of pandas where that alone is installed; raises ImportError."""
        for name in FRAMES:
            with contextlib.suppress(ModuleNotFoundError):
                return importlib.import_module(name).DataFrame(self.rows())
        raise ImportError("to_frame() needs polars or pandas: pip install polars. rows() gives the same without them.")

    def resume(self, *, jobs: int = 1, progress: bool = True, ends: threading.Event | None = None) -> "Runs":
        """Carry out what is left; raises DefinitionError `CHANGED` where a file is not what it was."""
        plan = compile_suite(Path(read_manifest(self.folder).source), runs_python=True)
        return _carry_out(self.folder, continue_run(self.folder, plan), plan.suite, jobs, ends, shows=progress)

    def __str__(self) -> str:
        """`runs/tidy_table-1: 9/10 = 90.0 % [59.6, 98.2]`."""
        return f"{self.folder}: {self.rate}" + (f", {self.pending} left" if self.pending else "")

    def __repr__(self) -> str:
        return f"<{self}>"

    def _repr_html_(self) -> str:
        cells = [(str(each.seed), each.verdict, each.reason) for each in self.failures]
        rows = "".join(f"<tr><td>{'<td>'.join(map(escape, row))}" for row in cells[:SHOWN])
        table = f"<p>{count(len(cells), 'failure')}</p><table><tr><th>seed<th>verdict<th>why{rows}</table>"
        return f"<p><b>{escape(str(self))}</b></p>{table if cells else ''}"


def run_many(request: ManyRequest, *, jobs: int = 1, ends: threading.Event | None = None, shows: bool = True) -> Runs:
    """Carry out a goal graph with every seed, `jobs` side by side, until `ends` is set.

    Raises DefinitionError with every problem, before a folder is made, and `WOULD_OVERWRITE`; KeyboardInterrupt once
    the running episodes have ended, of which nothing is noted.
    """
    run = request.run
    if not request.seeds or min(request.seeds) < 0:
        raise DefinitionError.of("INVALID_VALUE", "seeds", repr(request.seeds), "numbers of at least 0, one or more")
    graph = get_file(run.graph, "goal_graphs")
    faults = get_file(run.faults, "faults").resolve() if run.faults is not None else None
    load_predicates(open_library(graph).iter_predicates())
    require_graphics()
    overrides = parse_overrides(run.overrides)
    check_request(graph, faults, overrides)
    variant = {
        "set": {
            path.removeprefix("parameters.").removesuffix(".default"): parse_yaml(text, path).data
            for path, text in overrides.items()
        },
        "files": {**request.settings} | _declare_speed(request),
        "faults": faults,
        "pictures": run.pictures,
        **{key: getattr(run, key) for key in ("world_mode", "sense", "prior")},
    }
    name = re.sub(r"[^a-z0-9]+", "_", graph.stem.lower())[:60].strip("_") or "goal"
    suite = {
        "suite": name,
        "objective": f"{graph.stem} with {count(len(request.seeds), 'seed')}",
        "tasks": {name: {"graph": graph.resolve(), "score": {VERDICT.name: "success"}}},
        "common": {key: value for key, value in variant.items() if value is not None},
        "seeds": request.seeds,
        "scorer": VERDICT.name,
        **({"verification": [run.verify]} if run.verify is not None else {}),
    }
    text = yaml.safe_dump(json.loads(msgspec.json.encode(suite, enc_hook=str)), sort_keys=False)
    with open_scratch() as scratch:
        source = scratch / SUITE
        source.write_text(text, encoding="utf-8")
        try:
            plan = compile_suite(source, runs_python=True)
        except DefinitionError as error:  # of what was passed, not of a file of the caller
            found = [replace(each, address="run_many") for each in error.problems]
            raise DefinitionError(found) from error
        if plan.missing:
            raise DefinitionError([problem for why in plan.missing.values() for problem in why])
        folder = request.folder or choose_folder(RUNS, name)
        manifest = begin_run(folder, source, plan, SystemClock(), is_own=True)
    return _carry_out(folder, manifest, plan.suite, jobs, ends, shows=shows)


def _declare_speed(request: ManyRequest) -> dict[str, Mapping[str, object]]:
    name, speed = "runtime_contract.yaml", request.run.speed
    return {} if speed is None else {name: {**request.settings.get(name, {}), "speed": speed}}


def compare(a: Runs, b: Runs, of: Figure = Figure.FINAL) -> Comparison:
    """What B is against A, paired by seed: McNemar's exact test. Raises DefinitionError `CHANGED`."""
    ours, theirs = ([each.record for each in runs.episodes] for runs in (a, b))
    return compare_records(ours, theirs, of)


def _carry_out(
    folder: Path, manifest: Manifest, suite: "Suite", jobs: int, ends: threading.Event | None, *, shows: bool
) -> Runs:
    engine = open_engine(EngineName.LOCAL, jobs, ends)
    with _showing(folder, shows=shows) as show:
        show(Runs.open(folder))
        try:
            for _ in run_sweep(folder, manifest, engine, suite.policies, SystemClock()):
                show(Runs.open(folder))
        except KeyboardInterrupt as error:
            error.add_note(f"{Runs.open(folder)}. The rest: paos.open_runs({str(folder)!r}).resume()")
            raise
    return Runs.open(folder)


@contextlib.contextmanager
def _showing(folder: Path, *, shows: bool) -> Iterator[Callable[[Runs], object]]:
    """How far the runs are: a bar on a terminal, the runs so far in a notebook, nothing elsewhere."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if shows and hasattr(shell, "kernel"):
        display = importlib.import_module("IPython.display").display
        handle = display({"text/plain": str(folder)}, raw=True, display_id=True)
        yield lambda runs: handle.update({"text/html": runs._repr_html_(), "text/plain": str(runs)}, raw=True)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TimeElapsedColumn(), TextColumn("{task.description}"), BarColumn())
    with Progress(*columns, console=console, disable=not (shows and console.is_terminal)) as bar:
        task = bar.add_task(str(folder))

        def show(runs: Runs) -> None:
            done = len(runs.episodes)
            bar.update(task, description=str(runs), completed=done, total=done + runs.pending)

        yield show
