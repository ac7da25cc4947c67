"""Calls of each library of planning over goal graphs, from the evidence of one run of each."""

import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console

import phyagentos as paos
from benchmarks.runner import show
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


def show_calls(graphs: Iterable[str], seed: int, console: Console) -> None:
    """A row for each graph, and their sum."""
    found: dict[str, Counter[str]] = {}
    for graph in graphs:
        try:
            found[graph] = count_calls(graph, seed)
        except DefinitionError as error:
            console.print(f"left out: {graph}: {error}", style="yellow")
    found["all"] = sum(found.values(), Counter())
    rows = ((graph, *(calls[solver] for solver in Solver)) for graph, calls in found.items())
    show("calls of each library, by goal graph", ("goal graph", *Solver), rows, width=150)
