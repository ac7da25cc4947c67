"""`paos bench`: suites of episodes on the ordinary path, resumed after any end, reported and compared."""

import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from phyagentos.assembly.paths import choose_folder
from phyagentos.bench.availability import find_lacks, plan_setup, set_up
from phyagentos.bench.engines import EngineName, open_engine
from phyagentos.bench.matrix import compile_suite, find_environments, find_suite
from phyagentos.bench.records import BY_NAME, EpisodeRecord, read_records, select
from phyagentos.bench.rendering import render_json, render_markdown, write_reports
from phyagentos.bench.suite_file import Figure, Policy, read_suite
from phyagentos.bench.summary import compare as compare_records
from phyagentos.bench.summary import summarise
from phyagentos.bench.sweep import SUITE, Manifest, begin_run, continue_run, read_manifest, run_sweep
from phyagentos.cli.arguments import AsJson
from phyagentos.cli.outcome import Exit, ExitCode, print_found, print_note, print_result
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, Problem

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
) -> int:
    """Run a suite: check it, name what is missing here, carry every episode out, report."""
    path = find_suite(suite)
    plan = compile_suite(path, seeds)
    print_missing(plan.missing)
    if dry_run:
        print_result(f"{len(plan.orders)} episodes, {len(plan.missing)} missing")
        return ExitCode.REJECTED if plan.missing else ExitCode.GOAL_MET
    root = folder or choose_folder(Path("runs"), plan.suite.suite)
    manifest = begin_run(root, path, plan, SystemClock())
    print_note(f"run {root}: {len(plan.orders)} episodes, {len(plan.missing)} missing")
    return _sweep(root, manifest, plan.suite.policies, jobs, engine)


def resume(folder: Folder, jobs: Jobs = 1, engine: Where = EngineName.LOCAL) -> int:
    """Go on with a run that was ended or killed: nothing is repeated that has its record, and nothing is left out."""
    known = read_manifest(folder)
    plan = compile_suite(Path(known.source), known.seeds_max)
    manifest = continue_run(folder, plan)
    print_missing(manifest.missing)
    return _sweep(folder, manifest, plan.suite.policies, jobs, engine)


def report(folder: Folder, as_json: AsJson = False) -> int:
    """Write report.md, report.json and report.html into the folder of a run, as far as it is, and print the first."""
    summary = summarise(read_suite(folder / SUITE)[0], read_manifest(folder), read_records(folder))
    for path in write_reports(folder, summary):
        print_note(f"wrote {path}")
    print_result(render_json(summary) if as_json else render_markdown(summary))
    return ExitCode.GOAL_MET if summary.holds else ExitCode.GOAL_NOT_MET


def compare(
    a: Annotated[str, typer.Argument(help="Folder of a run; `RUN:pass=before,task=tidy` for some of its episodes.")],
    b: Annotated[str, typer.Argument(help="The one that may be worse.")],
    of: Annotated[Figure, typer.Option(help="What is compared: final, first, parts or first_parts.")] = Figure.FINAL,
    significant: Annotated[float, typer.Option(help="Greatest p value of a regression.", min=0.0, max=1.0)] = 0.05,
    as_json: AsJson = False,
) -> int:
    """Compare two runs, paired by seed: McNemar's exact test. Ends with 1 when B is worse, or lacks episodes of A."""
    found = compare_records(_read_chosen(a), _read_chosen(b), of)
    is_worse = found.is_regression(significant)
    lines = [f"A {found.a}", f"B {found.b}"]
    lines += [f"gained {len(found.gained)}, lost {len(found.lost)}, p = {found.p:.4g}"]
    listed = {"lost": found.lost, "gained": found.gained, "only in A": found.only_a, "only in B": found.only_b}
    for title, keys in listed.items():
        lines += [f"  {title}: {' '.join(filter(None, key))}" for key in keys]
    lines += ["B is worse" if is_worse else "B is not worse"]
    facts = {"comparison": found, "p": found.p, "regression": is_worse}
    print_found(facts, "\n".join(lines), as_json=as_json)
    return ExitCode.GOAL_NOT_MET if is_worse else ExitCode.GOAL_MET


def setup(
    name: Annotated[str, typer.Argument(help="An environment that a suite declares, or the suite.")],
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Install without asking.")] = False,
    python: Annotated[str, typer.Option(help="Interpreter that the environment is made with.")] = sys.executable,
) -> int:
    """Make the Python environment of another system that a suite declares; says first what it installs, and asks."""
    for each, spec in find_environments(name).items():
        if not (lacks := find_lacks(each, spec)):
            print_result(f"environment {each!r} is whole")
            continue
        print_note(f"environment {each!r} lacks: " + "; ".join(problem.found for problem in lacks))
        print_note("\n".join(["would run:", *("  " + " ".join(command) for command in plan_setup(each, spec, python))]))
        print_note(f"about {spec.gigabytes:g} GB. {spec.about}" if spec.gigabytes else spec.about)
        if not yes and not (sys.stdin.isatty() and typer.confirm("Install?", err=True)):
            raise Exit(ExitCode.INVALID_INPUT, "nothing was installed; --yes installs")
        print_result(f"environment {each!r}: {set_up(each, spec, print_note, python)}")
    return ExitCode.GOAL_MET


def print_missing(missing: Mapping[str, tuple[Problem, ...]]) -> None:
    """Why episodes cannot run here: each reason once, and how many episodes it keeps from running."""
    reasons = Counter(problem for problems in missing.values() for problem in problems)
    for problem, count in reasons.items():
        print_note(f"missing {count}: {problem}")


def _sweep(folder: Path, manifest: Manifest, policies: Mapping[str, Policy], jobs: int, engine: EngineName) -> int:
    console = Console(stderr=True)
    done = {record.id for record in read_records(folder)}
    total = sum(order.id not in manifest.missing for order in manifest.orders)
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(TextColumn("{task.description}"), *columns, console=console) as progress:
        bar = progress.add_task(folder.name, total=total, completed=len(done))
        for record in run_sweep(folder, manifest, open_engine(engine, jobs), policies, SystemClock()):
            progress.advance(bar)
            mark = "met" if record.is_met else f"not met, {record.taxon}"
            line = f"{record.id}: {record.verdict or record.ended}, {mark}, {record.wall_s:.1f} s"
            progress.console.print(line, style="dim", highlight=False, markup=False)
    return report(folder)


def _read_chosen(text: str) -> list[EpisodeRecord]:
    """Episodes of `RUN` or of `RUN:axis=value,…`."""
    folder, _, chosen = text.partition(":")
    read_manifest(Path(folder))
    where = dict(pair.partition("=")[::2] for pair in chosen.split(",") if pair)
    for axis in where:
        if axis not in BY_NAME:
            raise DefinitionError.unknown("UNKNOWN_NAME", text, axis, BY_NAME)
    return select(read_records(Path(folder)), where)
