"""What `paos bench` does: suites checked, runs begun, continued, reported and compared, environments made."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec

from phyagentos.assembly.graphics import require_graphics
from phyagentos.assembly.paths import choose_folder
from phyagentos.bench.availability import find_lacks, plan_setup, set_up
from phyagentos.bench.engines import EngineName, open_engine
from phyagentos.bench.matrix import compile_suite, find_environments, find_suite
from phyagentos.bench.records import BY_NAME, EpisodeRecord, read_records, select
from phyagentos.bench.rendering import write_reports
from phyagentos.bench.suite_file import Figure, Policy, read_suite
from phyagentos.bench.summary import SIGNIFICANT, Comparison, Summary, summarise
from phyagentos.bench.summary import compare as compare_records
from phyagentos.bench.sweep import SUITE, Manifest, begin_run, continue_run, read_manifest, run_sweep
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, Problem

RUNS = Path("runs")  # of the working folder: where runs are made
OnBegun = Callable[[Path, Manifest, int], object]  # folder of a run, what it is, and how many episodes have ended


class SuiteCheck(msgspec.Struct, frozen=True, kw_only=True):
    """How many episodes a suite has, and why some of them cannot run here, by id."""

    episodes: int
    missing: dict[str, tuple[Problem, ...]]


class RunComparison(msgspec.Struct, frozen=True, kw_only=True):
    """Two runs on their pairs of episodes, and whether the second is worse, or lacks episodes of the first."""

    comparison: Comparison
    is_regression: bool


class EnvironmentSetup(msgspec.Struct, frozen=True, kw_only=True):
    """A Python environment of another system: what it lacks, the commands that make it, and its interpreter if made."""

    environment: str
    lacks: tuple[Problem, ...]
    commands: tuple[tuple[str, ...], ...]
    gigabytes: float
    about: str
    python: Path | None = None


def check_suite(suite: Path, seeds_max: int | None = None) -> SuiteCheck:
    """Check a suite, a file or a name, with all that it names; raises DefinitionError with every problem."""
    plan = compile_suite(find_suite(suite), seeds_max, runs_python=True)
    return SuiteCheck(episodes=len(plan.orders), missing=dict(plan.missing))


def begin(
    suite: Path,
    folder: Path | None,
    on_begun: OnBegun,
    on_episode: Callable[[EpisodeRecord], object],
    *,
    seeds_max: int | None = None,
    jobs: int = 1,
    engine: EngineName = EngineName.LOCAL,
) -> Summary:
    """Carry out every episode of a suite that can run here, in a new folder (under runs/ without one), and report.

    Raises DefinitionError as `check_suite` does, and `WOULD_OVERWRITE`.
    """
    path = find_suite(suite)
    plan = compile_suite(path, seeds_max, runs_python=True)
    root = folder or choose_folder(RUNS, plan.suite.suite)
    manifest = begin_run(root, path, plan, SystemClock())
    return _sweep(root, manifest, plan.suite.policies, jobs, engine, on_begun, on_episode)


def resume(
    folder: Path,
    on_begun: OnBegun,
    on_episode: Callable[[EpisodeRecord], object],
    *,
    jobs: int = 1,
    engine: EngineName = EngineName.LOCAL,
) -> Summary:
    """Go on with a run: nothing is repeated that has its record. Raises `NOT_A_WORKSPACE`, `CHANGED`."""
    known = read_manifest(folder)
    plan = compile_suite(Path(known.source), known.seeds_max, runs_python=True)
    manifest = continue_run(folder, plan)
    return _sweep(folder, manifest, plan.suite.policies, jobs, engine, on_begun, on_episode)


def report(folder: Path) -> Summary:
    """The figures of a run as far as it is; writes report.md, report.json and report.html into its folder."""
    summary = summarise(read_suite(folder / SUITE)[0], read_manifest(folder), read_records(folder))
    write_reports(folder, summary)
    return summary


def compare(a: str, b: str, *, of: Figure = Figure.FINAL, significant: float = SIGNIFICANT) -> RunComparison:
    """Compare two runs, or parts of them (`RUN:axis=value,…`), paired by seed: McNemar's exact test.

    Raises DefinitionError `NOT_A_WORKSPACE`, `CHANGED`; `UNKNOWN_NAME` for an axis.
    """
    found = compare_records(_read_chosen(a), _read_chosen(b), of)
    return RunComparison(comparison=found, is_regression=found.is_regression(significant))


def plan_environments(name: str, python: str = sys.executable) -> tuple[EnvironmentSetup, ...]:
    """The environments of a suite, or one by its own name, as they are; raises DefinitionError `UNKNOWN_NAME`."""
    found = []
    for each, spec in find_environments(name).items():
        lacks = tuple(find_lacks(each, spec))
        commands = tuple(tuple(command) for command in (plan_setup(each, spec, python) if lacks else ()))
        setup = EnvironmentSetup(
            environment=each, lacks=lacks, commands=commands, gigabytes=spec.gigabytes, about=spec.about
        )
        found.append(setup)
    return tuple(found)


def make_environment(
    name: str,
    environment: str,
    on_command: Callable[[str], None],
    python: str = sys.executable,
    source: Path | None = None,
) -> Path:
    """Make or complete one of `plan_environments(name)`; its interpreter. Raises ExecutionError `EXTRA_MISSING`."""
    return set_up(environment, find_environments(name)[environment], on_command, python, source)


def _sweep(
    folder: Path,
    manifest: Manifest,
    policies: Mapping[str, Policy],
    jobs: int,
    engine: EngineName,
    on_begun: OnBegun,
    on_episode: Callable[[EpisodeRecord], object],
) -> Summary:
    require_graphics()
    on_begun(folder, manifest, len({record.id for record in read_records(folder)}))
    for record in run_sweep(folder, manifest, open_engine(engine, jobs), policies, SystemClock()):
        on_episode(record)
    return report(folder)


def _read_chosen(text: str) -> list[EpisodeRecord]:
    """Episodes of `RUN` or of `RUN:axis=value,…`."""
    folder, _, chosen = text.partition(":")
    read_manifest(Path(folder))
    where = dict(pair.partition("=")[::2] for pair in chosen.split(",") if pair)
    for axis in where:
        if axis not in BY_NAME:
            raise DefinitionError.unknown("axis", text, axis, BY_NAME)
    return select(read_records(Path(folder)), where)
