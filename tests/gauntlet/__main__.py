"""`python -m tests.gauntlet [NAME ...] [--write]`: plant lies, print which tests turn red; exit 1 if any does not."""

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from rich.console import Console
from rich.table import Table

from tests.gauntlet.running import Run, run_tests
from tests.gauntlet.sabotage import Sabotage
from tests.gauntlet.sabotages import SABOTAGES
from tests.gauntlet.table import PAGE, render_page


def main() -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(prog="python -m tests.gauntlet", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="sabotages to plant; all of them when none is named")
    parser.add_argument("--write", action="store_true", help=f"only renew {PAGE.name}")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), help="pytest processes at a time")
    arguments = parser.parse_args()
    if arguments.write:
        PAGE.write_text(render_page(), encoding="utf-8")
        return 0
    if unknown := set(arguments.names) - {each.name for each in SABOTAGES}:
        parser.error(f"no sabotage is called {', '.join(sorted(unknown))}")
    chosen = [each for each in SABOTAGES if not arguments.names or each.name in arguments.names]
    nodes = dict.fromkeys(node for each in chosen for node in each.tests)
    with ThreadPoolExecutor(arguments.processes) as pool:
        honest = pool.submit(run_tests, list(nodes))
        runs = list(pool.map(lambda each: run_tests(each.tests, each), chosen))
    return report(chosen, runs, honest.result(), list(nodes))


def report(chosen: Sequence[Sabotage], runs: Sequence[Run], honest: Run, nodes: Sequence[str]) -> int:
    """Print the table; the exit code."""
    table = Table("sabotage", "the lie", title="A gauntlet of lies")
    table.add_column("what the tests said", overflow="fold")
    table.add_column("s", justify="right")
    for sabotage, run in zip(chosen, runs, strict=True):
        told = "\n".join(
            f"{'red  ' if run.is_red(node) else 'MISS '} {node.partition('::')[2]}" for node in sabotage.tests
        )
        table.add_row(sabotage.name, sabotage.lie, told, f"{run.seconds:.1f}")
    missed = [each.name for each, run in zip(chosen, runs, strict=True) if not all(map(run.is_red, each.tests))]
    pale = [node for node in nodes if not honest.is_green(node)]
    console = Console(width=200)
    console.print(table)
    console.print(f"{len(chosen) - len(missed)} of {len(chosen)} sabotages turn every test red that they name.")
    console.print(f"{len(nodes) - len(pale)} of {len(nodes)} tests are green without any, in {honest.seconds:.1f} s.")
    for name in (*missed, *pale):
        console.print(f"  not as it should be: {name}")
    return 1 if missed or pale else 0


if __name__ == "__main__":
    raise SystemExit(main())
