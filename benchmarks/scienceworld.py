"""Tasks of ScienceWorld: `python -m benchmarks.scienceworld --outcomes FILE`.

It needs Java, and `make build/scienceworld/.installed`.

Each task is one of the environment's 30, in the first of its official *test* variations. Its description is understood
by a few forms of sentences and becomes a goal: sessions on the target `scientist`, by the ordinary path of `paos run`.
The score is the environment's own, 0 to 100 by its sub-goals, which only this script reads.

Given to the agent: what looking around and the inventory say, as symbols; the plan of the house; how old animals
become, how colours mix, which devices heat, cool and give power. Not given: gold paths, lists of valid actions, scores,
where objects are. Actions are not limited; published agents had about 100 of them, and other inputs.
"""

import argparse
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from benchmarks.runner import show
from benchmarks.scienceworld_parts.understand import understand, write_goal
from phyagentos.assembly.paths import OUTCOMES
from phyagentos.bench.suite import open_bench
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import PhyAgentOSError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

LIBRARY = Path(__file__).parent / "scienceworld_parts" / "library"
KIT = Path(__file__).parents[1] / "kits" / "scienceworld"
PUBLISHED = {"SwiftSage": 84.7}  # arXiv:2305.17390
NO_COMPARISON = "no comparison: that is by language models given the text, under a limit of actions"
Task = Mapping[str, Any]


def list_tasks(python: Path, split: str, count: int) -> list[Task]:
    """The first variations of a split of every task: `task`, `variation`, `description`."""
    command = [str(python), "-m", "scienceworld_body.tasks", split, str(count)]
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": str(KIT)}, capture_output=True, text=True, check=True
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def write_project(folder: Path, tasks: Iterable[Task]) -> Path:
    """The library of the benchmark with a scene for each task of the environment; its folder."""
    library = Path(shutil.copytree(LIBRARY, folder / "library"))
    house = yaml.safe_load((library / "scenes" / "house.yaml").read_text(encoding="utf-8"))
    for task in {each["task"] for each in tasks}:
        text = yaml.safe_dump(house | {"scene": task})
        (library / "scenes" / f"{task}.yaml").write_text(text, encoding="utf-8")
    return library


def try_tasks(tasks: Sequence[Task], clock: Clock) -> Iterator[dict[str, Any]]:
    """Each task in one workspace, one after the other: the verdict, and what the environment says."""
    with tempfile.TemporaryDirectory() as folder:
        library = write_project(Path(folder), tasks)
        workspace = Workspace.create(Path(folder) / "w", Library.open(library))
        with open_bench(workspace, clock) as agent:
            for task in tasks:
                name = f"{task['task']}_{task['variation']}".replace("-", "_")
                line: dict[str, Any] = {**task, "verdict": "none"}
                try:
                    graph = write_goal(name, task["task"], understand(task["description"]))
                    file = library / "goal_graphs" / f"{name}.yaml"
                    file.write_text(yaml.safe_dump(graph, sort_keys=False), encoding="utf-8")
                    report = agent.mission.run(file, seed=task["variation"], goal=name)
                    line |= {"verdict": str(report.verdict), "why": report.reason, "wall_s": round(report.wall_s, 1)}
                except (PhyAgentOSError, ValueError) as error:
                    line["why"] = str(error)
                yield line | read_score(workspace.root / OUTCOMES, task)


def read_score(file: Path, task: Task) -> dict[str, int]:
    """The environment's score when the last session of a task ended; 0 where none began."""
    lines = map(json.loads, file.read_text(encoding="utf-8").splitlines() if file.exists() else ())
    mine = [each for each in lines if (each["task"], each["variation"]) == (task["task"], task["variation"])]
    return {"score": max(0, mine[-1]["score"]), "actions": mine[-1]["actions"]} if mine else {"score": 0, "actions": 0}


def read_outcomes(file: Path) -> dict[tuple[str, int], Mapping[str, Any]]:
    """The last line of each task and variation."""
    lines = map(json.loads, file.read_text(encoding="utf-8").splitlines() if file.exists() else ())
    return {(line["task"], line["variation"]): line for line in lines}


def sum_up(outcomes: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """The mean score, of tasks by the mean of their variations; shares are of variations."""
    lines = [*outcomes]
    by_task = {task: [each["score"] for each in lines if each["task"] == task] for task in {x["task"] for x in lines}}
    means = {task: sum(scores) / len(scores) for task, scores in by_task.items()}
    false = [each for each in lines if each["verdict"] == "success" and each["score"] < 100]
    return {
        "tasks": len(means),
        "variations": len(lines),
        "score_mean": round(sum(means.values()) / len(means), 1),
        "full_share": round(sum(each["score"] == 100 for each in lines) / len(lines), 3),
        "false_success_share": round(len(false) / len(lines), 3),
        "actions_mean": round(sum(each["actions"] for each in lines) / len(lines), 1),
        **{f"score_{task.replace('-', '_')}": round(mean, 1) for task, mean in sorted(means.items())},
    }


def main() -> None:
    """Try what has no outcome yet, and print the table and the figures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--python", type=Path, default=Path("build/scienceworld/bin/python"))
    parser.add_argument("--split", choices=["train", "dev", "test"], default="test")
    parser.add_argument("--count", type=int, default=1, help="variations of each task")
    parser.add_argument("--tasks", nargs="*", help="of the environment; all where none is named")
    parser.add_argument("--outcomes", type=Path, required=True, help="JSON lines, appended to; all in it count")
    given = parser.parse_args()
    known = read_outcomes(given.outcomes)
    listed = list_tasks(given.python, given.split, given.count)
    tasks = [each for each in listed if not given.tasks or each["task"] in given.tasks]
    if left := [each for each in tasks if (each["task"], each["variation"]) not in known]:
        for line in try_tasks(left, SystemClock()):
            with given.outcomes.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
    lines = [*read_outcomes(given.outcomes).values()]
    rows = [(each["task"], each["variation"], each["score"], each["actions"], each["verdict"]) for each in lines]
    show("ScienceWorld", ("task", "variation", "score", "actions", "verdict"), rows)
    print(", ".join(f"{name} {score}" for name, score in PUBLISHED.items()), "(published);", NO_COMPARISON)
    print(json.dumps({"figures": sum_up(lines)}))


if __name__ == "__main__":
    main()
