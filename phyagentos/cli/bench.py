"""`paos bench`: suites of episodes on the ordinary path, resumed after any end, reported and compared."""

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from phyagentos.bench import runs
from phyagentos.bench.engines import EngineName
from phyagentos.bench.records import EpisodeRecord
from phyagentos.bench.rendering import NAMES, render_markdown
from phyagentos.bench.runs import EnvironmentSetup, OnBegun, RunComparison, SuiteCheck
from phyagentos.bench.suite_file import Figure
from phyagentos.bench.summary import Summary
from phyagentos.bench.sweep import Manifest
from phyagentos.cli.outcome import Exit, ExitCode, print_note
from phyagentos.cli.reply import Reply
from phyagentos.errors import Problem
from phyagentos.wording import count

Folder = Annotated[Path, typer.Argument(help="Folder of a run, as `paos bench run` made it.", file_okay=False)]
SuiteFile = Annotated[Path, typer.Argument(help="A suite: a file, or a name in benchmarks/suites/.")]
Jobs = Annotated[int, typer.Option("--jobs", "-j", min=1, help="Episodes side by side, in processes of their own.")]
NewRun = Annotated[Path | None, typer.Option("--run", "-r", help="Folder of the run; a new one under runs/.")]
Where = Annotated[EngineName, typer.Option(help="Where episodes are carried out; `ray` needs the extra of this name.")]


def run(
    suite: SuiteFile,
    folder: NewRun = None,
    jobs: Jobs = 1,
    engine: Where = EngineName.LOCAL,
    seeds: Annotated[int | None, typer.Option(help="Only so many seeds of each pass.", min=1)] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check, name what is missing, and run nothing.")] = False,
) -> Reply[Summary | SuiteCheck]:
    """Run a suite: check it, name what is missing here, carry every episode out, report."""
    if dry_run:
        found = runs.check_suite(suite, seeds)
        text = _count(found.episodes, len(found.missing))
        return Reply(
            found, text, _list_missing(found.missing), ExitCode.REJECTED if found.missing else ExitCode.GOAL_MET
        )
    with _progress() as (begun, ended):
        return _show(runs.begin(suite, folder, begun, ended, seeds_max=seeds, jobs=jobs, engine=engine))


def resume(folder: Folder, jobs: Jobs = 1, engine: Where = EngineName.LOCAL) -> Reply[Summary]:
    """Go on with a run that was ended or killed: nothing is repeated that has its record, and nothing is left out."""
    with _progress() as (begun, ended):
        return _show(runs.resume(folder, begun, ended, jobs=jobs, engine=engine))


def report(folder: Folder) -> Reply[Summary]:
    """Write report.md, report.json and report.html into the folder of a run, as far as it is, and print the first."""
    return _show(runs.report(folder), [f"wrote {folder / name}" for name in NAMES])


def compare(
    a: Annotated[str, typer.Argument(help="Folder of a run; `RUN:pass=before,task=tidy` for some of its episodes.")],
    b: Annotated[str, typer.Argument(help="The one that may be worse.")],
    of: Annotated[Figure, typer.Option(help="What is compared: final, first, parts or first_parts.")] = Figure.FINAL,
    significant: Annotated[float, typer.Option(help="Greatest p value of a regression.", min=0.0, max=1.0)] = 0.05,
) -> Reply[RunComparison]:
    """Compare two runs, paired by seed: McNemar's exact test. Ends with 1 when B is worse, or lacks episodes of A."""
    found = runs.compare(a, b, of=of, significant=significant)
    worse = "B is worse" if found.is_regression else "B is not worse"
    return Reply(
        found, f"{found.comparison}\n{worse}", code=ExitCode.GOAL_NOT_MET if found.is_regression else ExitCode.GOAL_MET
    )


def setup(
    name: Annotated[str, typer.Argument(help="An environment that a suite declares, or the suite.")],
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Install without asking.")] = False,
    python: Annotated[str, typer.Option(help="Interpreter that the environment is made with.")] = sys.executable,
    source: Annotated[
        Path | None, typer.Option("--from", help="Your clone of what is on no registry; it is checked, and used there.")
    ] = None,
) -> Reply[tuple[EnvironmentSetup, ...]]:
    """Make the Python environment of another system that a suite declares; says first what it installs, and asks."""
    made, lines = [], []
    for each in runs.plan_environments(name, python):
        if not each.lacks and source is None:
            made.append(each)
            lines.append(f"environment {each.environment!r} is whole")
            continue
        print_note(f"environment {each.environment!r} lacks: " + "; ".join(problem.found for problem in each.lacks))
        if each.commands:
            print_note("\n".join(["would run:", *("  " + " ".join(command) for command in each.commands)]))
        print_note(f"about {each.gigabytes:g} GB. {each.about}" if each.gigabytes else each.about)
        if not each.commands:
            raise Exit(ExitCode.INVALID_INPUT, "nothing was installed; install what it lacks")
        if not yes and not (sys.stdin.isatty() and typer.confirm("Install?", err=True)):
            raise Exit(ExitCode.INVALID_INPUT, "nothing was installed; --yes installs")
        made.append(replace(each, python=runs.make_environment(name, each.environment, print_note, python, source)))
        lines.append(f"environment {each.environment!r}: {made[-1].python}")
    return Reply(tuple(made), "\n".join(lines))


def _count(episodes: int, missing: int) -> str:
    return f"{count(episodes, 'episode')}, {missing} missing"


def _list_missing(missing: Mapping[str, Sequence[Problem]]) -> list[str]:
    """Why episodes cannot run here: each reason once, and how many episodes it keeps from running."""
    reasons = Counter(problem for problems in missing.values() for problem in problems)
    return [f"missing {number}: {problem}" for problem, number in reasons.items()]


def _show(summary: Summary, notes: list[str] | None = None) -> Reply[Summary]:
    code = ExitCode.GOAL_MET if summary.holds else ExitCode.GOAL_NOT_MET
    return Reply(summary, render_markdown(summary), notes or [], code)


@contextmanager
def _progress() -> Iterator[tuple[OnBegun, Callable[[EpisodeRecord], None]]]:
    """Callbacks that show how far a run is, and each episode as it ends."""
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(TextColumn("{task.description}"), *columns, console=Console(stderr=True)) as progress:

        def begin(folder: Path, manifest: Manifest, done: int) -> None:
            episodes, missing = len(manifest.orders), manifest.missing
            print_note("\n".join([*_list_missing(missing), f"run {folder}: {_count(episodes, len(missing))}"]))
            progress.add_task(folder.name, total=episodes - len(missing), completed=done)

        def end(record: EpisodeRecord) -> None:
            progress.advance(progress.task_ids[0])
            mark = "met" if record.is_met else f"not met, {record.taxon}"
            line = f"{record.id}: {record.verdict or record.ended}, {mark}, {record.wall_s:.1f} s"
            progress.console.print(line, style="dim", highlight=False, markup=False)

        yield begin, end
