"""Skills on held-out instances: each drawn from a seed, perceived, with the honest body, judged by independent code.

    python -m benchmarks.skills --skill press --count 50 [--first 1000] [--results FILE] [--keep FOLDER]

Each instance is a scene of its own and a goal of one node, two replans allowed. *Met* is what the judge finds in the
recorded end of the last session, whatever the verdict says; a *false success* is a verdict of success that the judge
contradicts, in any session. With `--spoilt` none can be met: joints are stuck, and what moves freely is too heavy.
Development uses the seeds below 1000.
"""

import argparse
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import yaml

from benchmarks.skills_parts.judge import Judge
from benchmarks.skills_parts.rooms import DRAWERS, Instance, draw
from phyagentos.assembly.agent_plane import Agent, MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.workspace import Workspace

HELD_OUT = 1000  # the first seed of instances that no one has developed with


def write_project(instances: list[Instance], root: Path) -> None:
    """A project folder with every scene and goal graph."""
    for each in instances:
        for path, data in (
            (root / "scenes" / "skills" / f"{each.name}.yaml", each.as_scene()),
            (root / "goal_graphs" / f"{each.name}.yaml", each.as_goal()),
        ):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(yaml.safe_dump(data, sort_keys=False))


def run(instances: list[Instance], folder: Path, sense: str) -> Iterator[dict[str, object]]:
    """One record an instance, in order, on one warm plane."""
    write_project(instances, folder / "project")
    workspace = open_project(folder / "workspace", folder / "project")
    with open_bench(workspace, SystemClock(), sense=Sensing(sense), memory_use=MemoryUse.NONE) as agent:
        for each in instances:
            yield run_one(agent, workspace, folder / "project", each)


def run_one(agent: Agent, workspace: Workspace, project: Path, each: Instance) -> dict[str, object]:
    """Run and judge one instance."""
    graph = project / "goal_graphs" / f"{each.name}.yaml"
    report = agent.mission.run(graph, seed=each.seed, goal=GoalId(each.name))
    run = [one for one in report.sessions if (workspace.evidence / one.id / "terminal.npz").exists()]
    unmet = {
        one.id: Judge(workspace.evidence / one.id, workspace.evidence / run[0].id).find_unmet(each.truth) for one in run
    }
    false = [one.id for one in run if one.verdict == "success" and unmet[one.id]]
    last = run[-1].id if run else ""
    return {
        "skill": each.skill,
        "seed": each.seed,
        "verdict": report.verdict,
        "met": bool(run) and not unmet[last],
        "first": bool(run) and not unmet[run[0].id],
        "false_success": [*false, *([report.goal] if report.verdict == "success" and (not run or unmet[last]) else [])],
        "unmet": unmet.get(last, ["no session ran"]),
        "reason": "" if report.verdict == "success" else report.reason,
    }


def summarise(records: list[dict[str, object]]) -> dict[str, object]:
    """The figures of one skill."""
    return {
        "instances": len(records),
        "met": sum(bool(one["met"]) for one in records),
        "first_attempt": sum(bool(one["first"]) for one in records),
        "false_successes": sum(bool(one["false_success"]) for one in records),
        "false_failures": sum(bool(one["met"]) and one["verdict"] != "success" for one in records),
    }


def main() -> None:
    """Run, print a table and one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skill", action="append", choices=sorted(DRAWERS), help="repeatable; all by default")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--first", type=int, default=HELD_OUT)
    parser.add_argument("--spoilt", action="store_true", help="instances that cannot be met")
    parser.add_argument("--sense", choices=("perceived", "truth"), default="perceived")
    parser.add_argument("--results", type=Path, help="one line of JSON an instance is appended")
    parser.add_argument("--keep", type=Path, help="folder in which the workspaces stay")
    chosen = parser.parse_args()
    table: dict[str, dict[str, object]] = {}
    for skill in chosen.skill or list(DRAWERS):
        folder = Path(tempfile.mkdtemp()) if chosen.keep is None else chosen.keep / skill
        records, seeds = [], range(chosen.first, chosen.first + chosen.count)
        drawn = [draw(skill, seed, spoilt=chosen.spoilt) for seed in seeds]
        for record in run(drawn, folder, chosen.sense):
            records.append(record)
            print(json.dumps(record), file=sys.stderr, flush=True)
            if chosen.results is not None:
                with chosen.results.open("a") as file:
                    file.write(json.dumps(record) + "\n")
        if chosen.keep is None:
            shutil.rmtree(folder, ignore_errors=True)
        table[skill] = summarise(records)
    print(f"{'skill':14}{'instances':>10}{'met':>6}{'first attempt':>15}{'false success':>15}{'false failure':>15}")
    for skill, row in table.items():
        print(
            f"{skill:14}" + "".join(f"{row[key]:>{width}}" for key, width in zip(row, (10, 6, 15, 15, 15), strict=True))
        )
    print(
        json.dumps(
            {
                "benchmark": "skills",
                "first": chosen.first,
                "spoilt": chosen.spoilt,
                "sense": chosen.sense,
                "skills": table,
            }
        )
    )
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
