"""Verdicts on LIBERO's tasks against its hidden predicate: 0 false successes are asked, and few false failures.

    make build/libero/.installed        # a Python environment with the extra `libero`: 2.1 GB
    python -m benchmarks.libero_verdicts --results verdicts.jsonl            # all suites, three initial states a task
    python -m benchmarks.libero_verdicts --suites libero_10 --tasks 3 --states 0 --results verdicts.jsonl
    python -m benchmarks.libero_verdicts --show --results verdicts.jsonl --with-runs libero.jsonl

An episode is one task from one of its official initial states. In it several moments are made by the world's own hand
and by physics: the goal met, dropped, narrowly missed, met with another thing or elsewhere, half of it, a joint short
of its end, a thing covered by another, a thing hidden from view and maybe taken away meanwhile; the untouched start is
a natural failure. At each of them a session looks and is judged as at the end of any session. The label is what the
benchmark's predicate says, whatever was meant: its process appends it to a file that is read after the verdict.

What is known: the sensing is *state*, so the poses and shapes of all things are the simulator's own, but for what is
hidden. `--with-runs` counts the ends of real runs, from results of `benchmarks.libero`, as cases too. Every draw
descends from the seed. Each case is one line of the results file: a run resumes with the episode at which it stopped.
"""

import argparse
import json
import sys
from itertools import product
from pathlib import Path

from rich.console import Console

from benchmarks.libero import PRO, SUITES, TASKS
from benchmarks.libero_parts.moment_cases import Record, judge_again, judge_suite, open_verifier
from benchmarks.libero_parts.verdict_figures import ASKED, Case, compute_figures, read_case, read_run, show
from benchmarks.runner import finish
from phyagentos.errors import DefinitionError, ExecutionError

SEED = 20_261_125
STATES = 3
Episode = tuple[str, int, int]


def main() -> int:
    """Run what is missing, show everything, and exit with whether every asked figure holds."""
    given = parse_arguments()
    console = Console(stderr=True)
    for suite in () if given.show else given.suites:
        run_suite(given, suite, console)
    known = read_results(given.results)
    wanted = list(product(given.suites, given.tasks, given.states))
    records = [record for key in wanted for record in known.get(key, ())]
    if given.again:
        verifier = open_verifier()
        records = [judge_again(given, record, verifier) for record in records]
    cases = [read_case(record) for record in records]
    cases += [case for path in given.with_runs for case in read_runs(path)]
    show(Console(), cases, given.seed)
    figures = compute_figures(cases, given.seed) | {"missing": sum(key not in known for key in wanted)}
    return finish(figures, ASKED)


def run_suite(given: argparse.Namespace, suite: str, console: Console) -> None:
    """Judge and keep what is missing; a target that is lost leaves the rest of its suite to another run."""
    known = read_results(given.results)
    missing = {task: [state for state in given.states if (suite, task, state) not in known] for task in given.tasks}
    missing = {task: states for task, states in missing.items() if states}
    try:
        for records in judge_suite(given, suite, missing) if missing else ():
            append(given.results, records)
            cases = [read_case(each) for each in records]
            told = f"{sum(each.success for each in cases)} met, {sum(each.is_wrong for each in cases)} wrong"
            name = f"{suite}/{records[0]['task']} from {records[0]['state']}"
            seconds = sum(each["wall_s"] for each in records)
            console.print(f"{name}: {len(cases)} cases, {told}, {seconds:.0f} s", highlight=False)
    except (DefinitionError, ExecutionError, RuntimeError) as error:
        console.print(f"{suite}: {error}", style="red", highlight=False)


def parse_arguments() -> argparse.Namespace:
    """What is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", type=Path, default=Path("build/libero/bin/python"))
    parser.add_argument("--suites", nargs="+", default=[*SUITES, *PRO])
    parser.add_argument("--show", action="store_true", help="run nothing, show the figures of the results")
    parser.add_argument("--tasks", type=int, nargs="+", default=list(range(TASKS)))
    parser.add_argument("--states", type=int, nargs="+", default=list(range(STATES)), help="official initial states")
    parser.add_argument("--seed", type=int, default=SEED, help="of every draw, and of the bootstrap")
    parser.add_argument("--results", type=Path, required=True, help="one JSON line a case; what stands there is kept")
    parser.add_argument("--with-runs", type=Path, nargs="+", default=[], help="results of benchmarks.libero")
    parser.add_argument("--keep", type=Path, help="folder for projects and evidence, kept afterwards")
    parser.add_argument("--again", action="store_true", help="judge the evidence in --keep by the verifier of today")
    given = parser.parse_args()
    if given.again and given.keep is None:
        parser.error("--again needs the evidence that --keep FOLDER has")
    return given


def append(path: Path, records: list[Record]) -> None:
    """All cases of one episode at once; each line tells how many there are."""
    lines = "".join(json.dumps(each | {"of": len(records)}) + "\n" for each in records)
    with path.open("a", encoding="utf-8") as results:
        results.write(lines)


def read_results(path: Path) -> dict[Episode, list[Record]]:
    """Cases of the episodes that are whole; one that a kill cut off is run again."""
    found: dict[Episode, dict[tuple[str, int], Record]] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            record = json.loads(line)
            episode = (record["suite"], record["task"], record["state"])
            found.setdefault(episode, {})[record["kind"], record["number"]] = record
        except (ValueError, KeyError):
            continue
    records = {episode: list(each.values()) for episode, each in found.items()}
    return {episode: each for episode, each in records.items() if len(each) == each[0]["of"]}


def read_runs(path: Path) -> list[Case]:
    """The ends of real runs."""
    return [read_run(json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines() if line]


if __name__ == "__main__":
    sys.exit(main())
