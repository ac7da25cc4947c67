"""Many goals on the ordinary path: one warm runtime plane, one mission after the other. Paper section 4.4.

Upstream: a benchmark. Downstream: the agent's mission; the runtime plane is a process of its own, as in every run.
Nothing here acts, judges or records in another way than `paos run` does.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from phyagentos.agent.mission.mission import Mission
from phyagentos.agent.mission.report import MissionReport
from phyagentos.clock import Clock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Journal


@dataclass(frozen=True, slots=True)
class Episode:
    """One goal of a suite, ended.

    Attributes:
        seed: Root of its random choices.
        workspace: Where its evidence is.
    """

    seed: int
    workspace: Workspace
    report: MissionReport


def run_suite(workspace: Workspace, graph: Path, seeds: Sequence[int], clock: Clock) -> Iterator[Episode]:
    """Pursue the same goal graph with each seed, in order; a runtime plane must be watching the workspace.

    Args:
        workspace: Of the runtime plane.
        graph: The goal graph.
        seeds: One goal each.
        clock: For waiting.
    """
    journal = Journal(workspace.root, side=Side.AGENT, by="bench", clock=clock)
    mission = Mission(workspace, journal, clock=clock)
    try:
        for seed in seeds:
            yield Episode(seed=seed, workspace=workspace, report=mission.run(graph, seed=seed))
    finally:
        journal.close()
