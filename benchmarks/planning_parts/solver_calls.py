"""Calls of each library of planning over goal graphs, from the evidence of one run of each."""

import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.table import Table

import phyagentos as paos
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.evidence import count_solver_calls, read_bundle
from phyagentos.runtime.motion.calls import Solver


def count_calls(graph: str, seed: int) -> Counter[str]:
    """Run a shipped goal graph; the calls of all its sessions.

    Raises DefinitionError where its robot is missing here.
    """
    calls = Counter[str]()
    with tempfile.TemporaryDirectory(prefix="calls-") as folder:
        report = paos.run(graph, seed=seed, workspace=Path(folder) / "run", memory="none", pictures=False)
        for each in paos.open_workspace(report.workspace):
            if (execution := each.status.execution) is not None:
                calls += count_solver_calls(read_bundle(each.evidence, each.status.contract, execution).events)
    return calls


def tabulate_calls(graphs: Iterable[str], seed: int, console: Console) -> Table:
    """A row for each graph, and their sum."""
    table = Table(title="calls of each library, by goal graph")
    for column in ("goal graph", *Solver):
        table.add_column(column, justify="left" if column == "goal graph" else "right")
    total = Counter[str]()
    for graph in graphs:
        try:
            calls = count_calls(graph, seed)
        except DefinitionError as error:
            console.print(f"left out: {graph}: {error}", style="yellow")
            continue
        total += calls
        table.add_row(graph, *(str(calls[solver]) for solver in Solver))
    table.add_section()
    table.add_row("all", *(str(total[solver]) for solver in Solver))
    return table
