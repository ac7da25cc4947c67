"""Tasks in Luanti: `python -m benchmarks.luanti --groups Wood Stone --seeds 1 2 --outcomes FILE`.

Each task is an item that is to be carried, from bare hands in a forest that the seed makes: a goal without a plan,
planned by amounts from the game's book, and run on the target `player` by the ordinary path of `paos run`. The verdict
reads the server's inventory after the last session. One world and one life for each task.

Given to the agent: nodes along lines of view up to 16 nodes long, as symbols and without need of light; what it saw
before; the recipes, drops and times of digging of the game. Nothing of what is behind other nodes is known to it.
The land is at a height where the game's own table has all ores (kits/luanti). Debian ships no creatures and no
hunger for this game: damage is by falls, lava and drowning, and night falls.
"""

import argparse
import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from benchmarks.luanti_parts.hidden import HiddenBook, iter_verified, write_known
from benchmarks.luanti_parts.tasks import GROUPS
from benchmarks.runner import show
from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.bench.suite import open_bench
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import PhyAgentOSError
from phyagentos.operations.plan import PlannedGraph, plan
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

LIBRARY = Path(__file__).parent / "luanti_parts" / "library"
LIMITS = {"timeout_s": 1500, "wall_timeout_s": 900, "max_replans": 2}
PUBLISHED = {  # success by Optimus-3 and by PhyAgentOS, with keyboard and mouse in Minecraft: no comparison
    "Wood": (0.99, 0.99), "Stone": (0.95, 0.96), "Iron": (0.55, 0.52), "Gold": (0.10, 0.06), "Diamond": (0.15, 0.19),
    "RedStone": (0.29, 0.30), "Armor": (0.23, 0.15),
}  # fmt: skip
NO_COMPARISON = "no comparison: those agents are given pixels and lose most by keyboard and mouse, which none has here"


def write_goal(items: Sequence[str], to: Path, library: Library) -> Path:
    """The goal of carrying items, planned from bare hands; raises ValueError where there is no plan."""
    name = items[0] + (f"_and_{len(items) - 1}_more" if len(items) > 1 else "")
    wanted = {
        "goal": f"carry_{name}", "objective": f"Carry {', '.join(items)}, from bare hands.", "scene": "land",
        "targets": {"agent": "player"}, "accept": [f"holds({item}) >= 1" for item in items],
    }  # fmt: skip
    file = to / "goal.yaml"
    file.write_text(yaml.safe_dump(wanted), encoding="utf-8")
    planned = plan(file, library=library)
    if not isinstance(planned, PlannedGraph):
        raise ValueError(f"no plan for {name}: {planned}")
    file.write_text(yaml.safe_dump(yaml.safe_load(planned.graph) | {"defaults": LIMITS}), encoding="utf-8")
    return file


def try_tasks(
    tasks: Sequence[tuple[str, str, int]], clock: Clock, library: Library | None = None
) -> Iterator[dict[str, Any]]:
    """Each task of a group in the world of a seed, one after the other in one workspace: what came of it."""
    library = library or Library.open(LIBRARY)
    with tempfile.TemporaryDirectory() as folder:
        workspace = Workspace.create(Path(folder) / "w", library)
        with open_bench(workspace, clock) as agent:
            for group, item, seed in tasks:
                line: dict[str, Any] = {"group": group, "item": item, "seed": seed}
                try:
                    goal = write_goal([item], Path(folder), library)
                    report = agent.mission.run(goal, seed=seed, goal=f"carry_{item}-{seed}")
                except (PhyAgentOSError, ValueError) as error:
                    yield line | {"is_met": False, "why": str(error)}
                    continue
                line |= {"is_met": report.verdict == "success", "why": report.reason}
                line |= {"sessions": len(report.sessions), "wall_s": round(report.wall_s, 1)}
                yield line | {"sim_s": round(sum(each.sim_time_s for each in report.sessions), 1)}


def learn(sessions: int, seed: int, folder: Path, clock: Clock) -> set[str]:
    """Recipes that were verified in so many sessions of memory, the book hidden; one life after the other."""
    book, known, held, lived = HiddenBook.read(LIBRARY), set[str](), set[str](), 0
    while sessions > 0 and (wanted := book.choose_trials(known, held)):
        lived += 1
        while True:  # a life has no more sessions than are left
            library = write_known(LIBRARY, known.union(wanted), folder / f"library_{lived}_{len(wanted)}")
            goal = write_goal(wanted, folder, library)
            if len(yaml.safe_load(goal.read_text(encoding="utf-8"))["sessions"]) <= sessions or len(wanted) == 1:
                break
            wanted = wanted[:-1]
        workspace = Workspace.create(folder / f"life_{lived}", library)
        with open_bench(workspace, clock, memory=folder, memory_use=MemoryUse.LEARN) as agent:
            report = agent.mission.run(goal, seed=seed, goal=f"life_{lived}")
        sessions -= len(report.sessions)
        held |= {*iter_verified(workspace.knowledge)}
        known = held & book.recipes.keys()
        print(f"life {lived}: {len(report.sessions)} sessions, {len(known)} recipes known", flush=True)
    return known


def read_outcomes(file: Path) -> dict[tuple[str, str, int], Mapping[str, Any]]:
    """The last line of each task and seed."""
    lines = map(json.loads, file.read_text(encoding="utf-8").splitlines() if file.exists() else ())
    return {(line["group"], line["item"], line["seed"]): line for line in lines}


def sum_up(outcomes: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Tasks tried and the share that was met, of each group that was tried."""
    figures: dict[str, float] = {}
    tried = [*outcomes]
    for group in GROUPS:
        met = [line["is_met"] for line in tried if line["group"] == group]
        if met:
            figures |= {f"{group.lower()}_tried": len(met), f"{group.lower()}_met": round(sum(met) / len(met), 3)}
    return figures


def main() -> None:
    """Try what has no outcome yet, the first of every group first, and print the table and the figures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--groups", nargs="*", choices=[*GROUPS], default=[*GROUPS])
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(1, 6)))
    parser.add_argument("--outcomes", type=Path, required=True, help="JSON lines, appended to; all tasks in it count")
    parser.add_argument("--hidden", type=int, default=0, help="hide the book, and try recipes in so many sessions")
    given = parser.parse_args()
    known = read_outcomes(given.outcomes)
    turns = [(index, group) for group in given.groups for index in range(len(GROUPS[group]))]
    tasks = [(group, GROUPS[group][index], seed) for seed in given.seeds for index, group in sorted(turns)]
    with tempfile.TemporaryDirectory() as folder:
        library = Library.open(LIBRARY)
        if given.hidden:
            learned = learn(given.hidden, given.seeds[0], Path(folder), SystemClock())
            library = write_known(LIBRARY, learned, Path(folder) / "learned")
        for line in try_tasks([each for each in tasks if each not in known], SystemClock(), library):
            with given.outcomes.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
    figures = sum_up(read_outcomes(given.outcomes).values())
    show_table(figures)
    print(json.dumps({"figures": figures}))


def show_table(figures: Mapping[str, float]) -> None:
    """Each group beside what was published for other bodies."""
    rows: Sequence[Sequence[object]] = [
        (group, f"{figures[f'{key}_met']:.2f}", int(figures[f"{key}_tried"]), *PUBLISHED[group])
        for group in GROUPS
        if f"{(key := group.lower())}_met" in figures
    ]
    show("Luanti-67, our mapping", ("group", "met", "tried", "Optimus-3", "PhyAgentOS"), rows)
    print(NO_COMPARISON)


if __name__ == "__main__":
    main()
