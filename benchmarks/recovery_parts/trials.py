"""Goals to recover in: those of the benchmark's own scenes, and those of rooms drawn from seeds.

A trial knows its goal graph, and by which independent eye its end is judged.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import msgspec
import numpy as np
import yaml

from benchmarks.unseen_parts.cases import Case, Node
from benchmarks.unseen_parts.feasible import find_ambiguity, find_contradiction, list_obstacles
from benchmarks.unseen_parts.files import render_faults, render_goal, render_scene
from benchmarks.unseen_parts.goals import draw_case
from benchmarks.unseen_parts.records import Recorder, is_lasting
from phyagentos.agent.mission.report import MissionReport

SPARE_SESSIONS = 3  # that a drawn goal may have beside one for each node: a restart does not always fit
REPLANS = 4
UNDONE = "undone"  # what the first node moved is taken away again

IsMet = Callable[[Path, MissionReport], bool]
"""Whether the world at the end shows the goal met: from the folder of all bundles, and the report."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One goal with one seed.

    Attributes:
        case: What goes wrong; the tables count by it.
        goal: Its id, by which the fault file knows it.
    """

    case: str
    seed: int
    graph: Path
    goal: str
    is_met: IsMet


def judge_last_by(eye: Callable[[Path], bool]) -> IsMet:
    """Judge the bundle whose recorded end is the latest; without any nothing is met."""

    def is_met(evidence: Path, report: MissionReport) -> bool:
        folders = [evidence / session.id for session in report.sessions]
        seen = [f for f in folders if (f / "terminal.npz").exists() and (f / "scene.mjb").exists()]
        return bool(seen) and eye(max(seen, key=_find_time))

    return is_met


def draw_trials(first_seed: int, number: int, project: Path) -> list[Trial]:
    """Goals of two nodes or more in rooms drawn from seeds, each with a fault that need not last.

    Half of the faults are the generator's; in the other half a person takes away again what the first node moved, when
    the last one begins.

    Nodes that only claim something are left out: nothing is to be recovered there. What reach, opening, volume and
    friction forbid is not drawn, nor a goal whose own acceptance is empty.

    Args:
        first_seed: The seeds are the next from here that give such a goal.
        number: Of trials.
        project: Folder that gets scenes, goal graphs and the file of faults.
    """
    cases = list(_iter_cases(first_seed, number))
    for case in cases:
        _write(project / "scenes" / "unseen" / f"{case.name}.yaml", render_scene(case.room, case.name))
        graph = render_goal(case) | {"budget": {"sessions": len(case.nodes) + SPARE_SESSIONS, "sim_time_s": 240}}
        graph["defaults"] = {"timeout_s": 60, "max_replans": REPLANS}
        _write(project / "goal_graphs" / f"{case.name}.yaml", graph)
    _write(project / "faults.yaml", render_faults(cases))
    return [
        Trial(
            case=_tell_fault(case),
            seed=case.seed,
            graph=project / "goal_graphs" / f"{case.name}.yaml",
            goal=case.name,
            is_met=_judge_drawn(case),
        )
        for case in cases
    ]


def _iter_cases(first_seed: int, number: int) -> Iterator[Case]:
    found = 0
    for seed in count(first_seed):
        case = _drop_claims(draw_case(seed))
        if len(case.nodes) < 2 or not (case.faults and case.accept) or case.detail or _is_hopeless(case):
            continue
        yield _undo_first(case) if found % 2 else case
        found += 1
        if found == number:
            return


def _drop_claims(case: Case) -> Case:
    kept = {node.name for node in case.nodes if not node.is_claim}
    nodes = tuple(_cut(node, kept) for node in case.nodes if node.name in kept)
    asked = {text for node in nodes for text in node.accept}
    return replace(case, nodes=nodes, accept=tuple(text for text in case.accept if text in asked))


def _cut(node: Node, kept: set[str]) -> Node:
    return replace(node, after=tuple(name for name in node.after if name in kept))


def _undo_first(case: Case) -> Case:
    when = {"session": f"{case.name}.{case.nodes[-1].name}"}
    return replace(case, faults=({"kind": "move", "object": case.nodes[0].arguments["object"], "when": when},))


def _tell_fault(case: Case) -> str:
    when = case.faults[0]["when"]
    assert isinstance(when, dict)
    return UNDONE if "session" in when else str(case.faults[0]["kind"])


def _is_hopeless(case: Case) -> bool:
    return (
        any(is_lasting(fault) for fault in case.faults)
        or bool(find_contradiction(case))
        or any(list_obstacles(case, node) or find_ambiguity(case, node) for node in case.nodes)
    )


def _judge_drawn(case: Case) -> IsMet:
    def is_met(evidence: Path, report: MissionReport) -> bool:
        recorder = Recorder(case, "unseen", evidence, msgspec.to_builtins(report))
        return recorder.record(0.0).truth == "met"

    return is_met


def _find_time(folder: Path) -> float:
    """Simulated time of a recorded end, by which the latest is known [s]."""
    with np.load(folder / "terminal.npz") as terminal:
        return float(terminal["time"])


def _write(path: Path, data: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
