"""Goals to recover in, drawn from seeds: rooms of `benchmarks/worlds`, each with a fault that need not last.

Half of the faults are the generator's; in the other half a person takes away again what the first node moved, when the
last one begins. Nodes that only claim something are left out: nothing is to be recovered there. What reach, opening,
volume and friction forbid is not drawn, nor a goal whose own acceptance is empty: not every seed gives one, see `main`.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice
from pathlib import Path

from benchmarks.oracle.feasible import find_ambiguity, find_contradiction, list_obstacles
from benchmarks.worlds.cases import Case, Node
from benchmarks.worlds.faults import is_lasting
from benchmarks.worlds.goals import draw_case
from benchmarks.worlds.projects import write_case

SPARE_SESSIONS = 3  # that a drawn goal may have beside one for each node: a restart does not always fit
REPLANS = 4
STREAMS = (20_000, 1_500_000)  # first seeds: for development, held out


def draw(seed: int, folder: Path) -> Path:
    """Write the project of a seed that gives such a goal; its goal graph."""
    case = make_case(seed)
    budget = {"sessions": len(case.nodes) + SPARE_SESSIONS, "sim_time_s": 240}
    defaults = {"timeout_s": 60, "max_replans": REPLANS}
    return write_case(case, folder, f"{__name__}:make_case", budget=budget, defaults=defaults)


def make_case(seed: int) -> Case:
    """The case of a seed; what a person undoes is by turns, from the first seed of its stream on."""
    first = max(each for each in STREAMS if each <= seed)
    case = next(case for case in iter_cases(first) if case.seed >= seed)
    assert case.seed == seed, f"seed {seed} gives no goal to recover in; the next one is {case.seed}"
    return case


def iter_cases(first_seed: int) -> Iterator[Case]:
    """Those of the seeds from here."""
    found = 0
    for seed in count(first_seed):
        case = _drop_claims(draw_case(seed))
        if len(case.nodes) < 2 or not (case.faults and case.accept) or case.detail or _is_hopeless(case):
            continue
        yield _undo_first(case) if found % 2 else case
        found += 1


def _drop_claims(case: Case) -> Case:
    kept = {node.name for node in case.nodes if not node.is_claim}
    nodes = tuple(_cut(node, kept) for node in case.nodes if node.name in kept)
    asked = {text for node in nodes for text in node.accept}
    return replace(case, nodes=nodes, accept=tuple(text for text in case.accept if text in asked))


def _cut(node: Node, kept: set[str]) -> Node:
    return replace(node, after=tuple(name for name in node.after if name in kept))


def _undo_first(case: Case) -> Case:
    when = {"session": f"*.{case.nodes[-1].name}"}
    return replace(case, faults=({"kind": "move", "object": case.nodes[0].arguments["object"], "when": when},))


def _is_hopeless(case: Case) -> bool:
    return (
        any(is_lasting(fault) for fault in case.faults)
        or bool(find_contradiction(case))
        or any(list_obstacles(case, node) or find_ambiguity(case, node) for node in case.nodes)
    )


if __name__ == "__main__":
    print([case.seed for case in islice(iter_cases(int(sys.argv[1])), int(sys.argv[2]))])
