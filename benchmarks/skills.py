"""Skills on held-out instances: each drawn from a seed, perceived, with the honest body, judged by independent code.

    python -m benchmarks.skills --skill press --count 50 [--first 1000] [--results FILE] [--keep FOLDER]

Each instance is a scene of its own and a goal of one node, two replans allowed. *Met* is what the judge finds in the
recorded end of the last session, whatever the verdict says; a *false success* is a verdict of success that the judge
contradicts, in any session of the skill. With `--spoilt` none can be met: joints are stuck, and what moves freely is
too heavy.
Development uses the seeds below 1000.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import yaml
from rich.console import Console
from rich.table import Table

from benchmarks.skills_parts.judge import Judge
from benchmarks.skills_parts.rooms import DRAWERS, Instance, draw
from phyagentos.assembly.agent_plane import Agent, MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Ask, format_outcome
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.workspace import Workspace

LEAST = {"insert": 0.8, "pour": 0.8}  # asked of each: else 0.9
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
    own = (one for one in run if one.skill == each.skill)  # repairs promise other things
    false = [one.id for one in own if one.verdict == "success" and unmet[one.id]]
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


def build_figures(records: Mapping[str, list[dict[str, object]]]) -> dict[str, float]:
    """Shares of each skill, and the false successes of all."""
    figures = {}
    for skill, ones in records.items():
        figures[f"{skill}_met"] = sum(bool(one["met"]) for one in ones) / len(ones)
        figures[f"{skill}_first_attempt"] = sum(bool(one["first"]) for one in ones) / len(ones)
        wrong = sum(bool(one["met"]) and one["verdict"] != "success" for one in ones)
        figures[f"{skill}_false_failures"] = wrong / len(ones)
    figures["false_successes"] = float(sum(bool(one["false_success"]) for ones in records.values() for one in ones))
    return figures


def show(records: Mapping[str, list[dict[str, object]]], figures: Mapping[str, float]) -> None:
    """One row a skill."""
    table = Table(title="skills on instances drawn from seeds")
    for column in ("skill", "instances", "met, by the world", "at first attempt", "met, but told as failure"):
        table.add_column(column)
    for skill, ones in records.items():
        shares = (figures[f"{skill}_{name}"] for name in ("met", "first_attempt", "false_failures"))
        table.add_row(skill, str(len(ones)), *(f"{share:.2f}" for share in shares))
    Console().print(table)


def main() -> int:
    """Run, show, and tell whether every asked figure holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skill", action="append", choices=sorted(DRAWERS), help="repeatable; all by default")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--first", type=int, default=HELD_OUT)
    parser.add_argument("--spoilt", action="store_true", help="instances that cannot be met")
    parser.add_argument("--sense", choices=("perceived", "truth"), default="perceived")
    parser.add_argument("--results", type=Path, help="one line of JSON an instance is appended")
    parser.add_argument("--keep", type=Path, help="folder in which the workspaces stay")
    chosen = parser.parse_args()
    records: dict[str, list[dict[str, object]]] = {}
    for skill in chosen.skill or list(DRAWERS):
        seeds = range(chosen.first, chosen.first + chosen.count)
        drawn = [draw(skill, seed, spoilt=chosen.spoilt) for seed in seeds]
        with tempfile.TemporaryDirectory(prefix="skills-", ignore_cleanup_errors=True) as scratch:
            folder = Path(scratch) if chosen.keep is None else chosen.keep / skill
            for record in run(drawn, folder, chosen.sense):
                records.setdefault(skill, []).append(record)
                line = json.dumps(record)
                print(line, file=sys.stderr, flush=True)
                if chosen.results is not None:
                    with chosen.results.open("a") as file:
                        file.write(line + "\n")
    figures = build_figures(records)
    show(records, figures)
    asked = {} if chosen.spoilt else {f"{skill}_met": Ask(LEAST.get(skill, 0.9), at_least=True) for skill in records}
    line, holds = format_outcome(figures, asked | {"false_successes": Ask(0, at_least=False)})
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # whatever threads are left
