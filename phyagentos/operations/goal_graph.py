"""The graph of a goal as it stands: every attempt at a node, and what comes before it."""

from pathlib import Path

import msgspec

from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.tasks import Edge, Step, iter_edges, iter_steps
from phyagentos.store.subjects import get_goal
from phyagentos.store.views.tasks import render_graph


class StandingGraph(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos graph --json` prints; `mermaid` is the same as a flowchart."""

    goal: str
    objective: str
    graph: str
    verdict: str
    steps: tuple[Step, ...]
    edges: tuple[Edge, ...]
    mermaid: str


def show_graph(workspace: Path, goal: str = "") -> StandingGraph:
    """Read the graph of a goal, which need not be named where there is one; raises `UNKNOWN_NAME`."""
    status = get_goal(goal, str(workspace), read_ledger(workspace).goals)
    return StandingGraph(
        goal=status.id,
        objective=status.objective,
        graph=status.graph,
        verdict=status.verdict,
        steps=tuple(iter_steps(status)),
        edges=tuple(iter_edges(status)),
        mermaid=render_graph(status),
    )
