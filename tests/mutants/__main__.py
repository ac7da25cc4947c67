"""`python -m tests.mutants [NAME ...] [--write]`: plant mutants, print which tests turn red; exit 1 if any does not."""

import argparse
import os
from concurrent.futures import ThreadPoolExecutor

from rich.console import Console
from rich.table import Table

from tests.mutants.mutant import Mutant
from tests.mutants.page import PAGE, render_page
from tests.mutants.register import MUTANTS
from tests.mutants.running import Run, run_tests


def main() -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="mutants to plant; all of them when none is named")
    parser.add_argument("--write", action="store_true", help=f"only renew {PAGE.name}")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), help="pytest processes at a time")
    arguments = parser.parse_args()
    if arguments.write:
        PAGE.write_text(render_page(), encoding="utf-8")
        return 0
    if unknown := set(arguments.names) - {each.name for each in MUTANTS}:
        parser.error(f"no mutant is called {', '.join(sorted(unknown))}")
    chosen = [each for each in MUTANTS if not arguments.names or each.name in arguments.names]
    nodes = dict.fromkeys(node for each in chosen for node in each.tests)
    with ThreadPoolExecutor(arguments.processes) as pool:
        honest = pool.submit(run_tests, nodes)
        runs = dict(zip(chosen, pool.map(lambda each: run_tests(each.tests, each), chosen), strict=True))
    return report(runs, honest.result(), nodes)


def report(runs: dict[Mutant, Run], honest: Run, nodes: dict[str, None]) -> int:
    """Print the table; the exit code."""
    table = Table("mutant", "what it claims", title="Mutation tests")
    table.add_column("its tests", overflow="fold")
    table.add_column("s", justify="right")
    for mutant, run in runs.items():
        lines = (f"{'red   ' if run.is_red(node) else 'ALIVE '} {node.partition('::')[2]}" for node in mutant.tests)
        table.add_row(mutant.name, mutant.claim, "\n".join(lines), f"{run.seconds:.1f}")
    alive = [mutant.name for mutant, run in runs.items() if not all(map(run.is_red, mutant.tests))]
    pale = [node for node in nodes if not honest.is_green(node)]
    console = Console(width=200)
    console.print(table)
    console.print(f"{len(runs) - len(alive)} of {len(runs)} mutants killed: every test that stands beside one is red.")
    console.print(f"{len(nodes) - len(pale)} of {len(nodes)} tests are green without any, in {honest.seconds:.1f} s.")
    for name in (*alive, *pale):
        console.print(f"  not as expected: {name}")
    return 1 if alive or pale else 0


if __name__ == "__main__":
    raise SystemExit(main())
