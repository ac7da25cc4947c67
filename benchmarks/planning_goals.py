"""Sixty generated goals: planned, each plan judged by an independent validator, some of them run on physics.

    python benchmarks/planning_goals.py
    python benchmarks/planning_goals.py --execute 20
    python benchmarks/planning_goals.py --count 12 --execute 2 -v

A goal of a solvable family is reachable by construction and needs 3 to 12 sessions; of an unsolvable one the reason is
known. Time is that of the whole answer: facts, operators, plan, order, or proof; the first one holds the imports. With
`--execute`, goal graphs that take a closed drawer for an open one are run as well: the rest has to be planned anew.
"""

import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from time import perf_counter
from typing import Annotated

from typer import Option

from benchmarks.runner import finish, run, show
from benchmarks.worlds.kinematics import find_fault
from benchmarks.worlds.puzzles import SOLVABLE, UNSOLVABLE, Task, write_forgotten, write_task
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.bench.report import Threshold
from phyagentos.protocol.capabilities.library import Library

STEPS = range(3, 13)
FORGOTTEN = 3  # goal graphs that take a closed drawer for an open one
Planned = tuple[Path, Task]


def main(
    *,
    count: Annotated[int, Option(help="goals; a fifth of them cannot be reached")] = 60,
    execute: Annotated[int, Option(help="plans that are run on physics as well")] = 0,
    seed: Annotated[int, Option(help="of the first goal of each family")] = 0,
    verbose: Annotated[bool, Option("-v", "--verbose", help="a line for each goal")] = False,
) -> int:
    """Exit code 0 where every asked figure holds."""
    with tempfile.TemporaryDirectory(prefix="planning_goals_") as folder:
        return measure(Path(folder), count, seed, runs=execute, verbose=verbose)


def measure(folder: Path, count: int, first_seed: int, *, runs: int, verbose: bool) -> int:
    """Draw, answer, judge, and run some; print the table and the outcome."""
    tasks = list(draw_tasks(count, first_seed, folder))
    rows, times, graphs = {}, [], []
    for task in tasks:
        row = rows.setdefault(task.family, {"goals": 0, "answered": 0, "valid": 0, "sessions": []})
        row["goals"] += 1
        answered, fault, sessions, elapsed_s = answer(task, folder, graphs)
        times.append(elapsed_s)
        row["answered"] += answered
        row["valid"] += answered and not fault
        row["sessions"] += [sessions] if sessions else []
        if verbose or fault or not answered:
            said = fault or ("" if answered else "wrong answer")
            print(f"{task.wanted.goal:<14} {elapsed_s:6.3f} s  {sessions:>2} sessions  {said}", flush=True)
    executed = [execute(graph, task.seed) for graph, task in spread(graphs, runs)]
    spans = {
        family: row["sessions"] and f"{min(row['sessions'])} to {max(row['sessions'])}" for family, row in rows.items()
    }
    shown = ((family, row["goals"], row["answered"], row["valid"], spans[family] or "") for family, row in rows.items())
    show("", ("family", "goals", "answered rightly", "valid", "sessions"), shown)
    figures = {
        "goals": float(len(tasks)),
        "solved": mean(row["answered"] / row["goals"] for family, row in rows.items() if family in SOLVABLE),
        "said_unsolvable": mean(row["answered"] / row["goals"] for family, row in rows.items() if family in UNSOLVABLE),
        "valid": mean(row["valid"] / row["goals"] for row in rows.values()),
        "median_s": statistics.median(times),
        "slowest_s": max(times),
    }
    asked = {name: Threshold(1.0, at_least=True) for name in ("solved", "said_unsolvable", "valid")} | {
        "median_s": Threshold(1.0, at_least=False)
    }
    if executed:
        again = [execute(write_forgotten(seed, folder), seed) for seed in range(FORGOTTEN)]
        figures |= {"executed": float(len(executed)), "met_on_physics": mean(executed), "met_anew": mean(again)}
        asked |= {name: Threshold(1.0, at_least=True) for name in ("met_on_physics", "met_anew")}
    return finish(figures, asked)


def draw_tasks(count: int, seed: int, folder: Path) -> Iterator[Task]:
    """Goals of every family, four of five solvable and of 3 to 12 sessions."""
    unsolvable = count // 5
    for families, share in ((SOLVABLE, count - unsolvable), (UNSOLVABLE, unsolvable)):
        for index in range(share):
            family = list(families)[index % len(families)]
            yield write_task(family, seed + index // len(families), folder)


def answer(task: Task, folder: Path, graphs: list[Planned]) -> tuple[bool, str, int, float]:
    """Whether the answer is right, what is wrong with the plan, its sessions, and the time."""
    catalogue = Catalogue.read(Library.open(folder))
    start = perf_counter()
    from phyagentos.agent.planning.planned import PlannedGoal, plan_goal, write_graph

    planned = plan_goal(task.wanted, catalogue, task.world)
    elapsed_s = perf_counter() - start
    if not isinstance(planned, PlannedGoal):
        is_right = planned.is_proven and task.lack in {missing.lack.value for missing in planned.missing}
        said = "" if is_right else "; ".join(missing.describe() for missing in planned.missing)
        return is_right, said, 0, elapsed_s
    if task.lack:
        return False, "a plan for what cannot be reached", len(planned.steps), elapsed_s
    path = folder / "goal_graphs" / f"{task.wanted.goal}.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(write_graph(planned), encoding="utf-8")
    graph = read_goal_graph(path, catalogue)
    graphs.append((path, task))
    fault = find_fault(task.wanted, graph, task.world, task.seed)
    if len(planned.steps) not in STEPS:
        fault = fault or "not of 3 to 12 sessions"
    return True, fault, len(planned.steps), elapsed_s


def spread(graphs: list[Planned], count: int) -> list[Planned]:
    """So many, of every family alike."""
    return sorted(graphs, key=lambda each: each[1].seed)[:count]


def execute(path: Path, seed: int) -> bool:
    """Whether `paos run` meets the goal on physics."""
    workspace = path.parents[1] / "workspaces" / path.stem
    command = [sys.executable, "-m", "phyagentos", "run", str(path), "-w", str(workspace), "--seed", str(seed)]
    done = subprocess.run([*command, "--quiet", "--no-pictures"], capture_output=True, text=True, check=False)
    last = [line for line in done.stdout.splitlines() if line.startswith("goal ")]
    print(
        f"physics {path.stem:<14} {'met' if done.returncode == 0 else f'exit {done.returncode}'}  {last[:1]}",
        flush=True,
    )
    return done.returncode == 0


def mean(values: Iterable[float]) -> float:
    """1 without values: nothing was missed."""
    found = [float(value) for value in values]
    return sum(found) / len(found) if found else 1.0


if __name__ == "__main__":
    run(main)
