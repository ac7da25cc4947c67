"""LIBERO's tasks by the builtin skills, on the ordinary path, beside the benchmark's own scorer.

    make build/libero/.installed        # a Python environment with the extra `libero`: 2.1 GB
    python -m benchmarks.libero --results libero.jsonl                  # Spatial, Object, Goal and LIBERO-10
    python -m benchmarks.libero --suites libero_object --tasks 0 3 --states 0 1 --results libero.jsonl
    python -m benchmarks.libero --suites pro --results libero_pro.jsonl  # LIBERO-PRO: positions swapped, tasks changed
    python -m benchmarks.libero --show --results libero.jsonl           # the figures of what has been run

An episode is one task from one of its official initial states, with nothing given but the task's goal in BDDL. Goal
graphs are generated from it by effect; shapes, rooms, joints and handles are read from the environment's compiled
model. No code and no setting is of a task.

What is known, by the sensing:
- *state* (the default): the poses and shapes of all objects are the simulator's own.
- *perceived* (`--sensing perceived`): the poses of what moves, and how far joints are open, are found by the
  framework's own perception in colour and depth of LIBERO's two cameras, drawn on demand when it looks. Known
  beforehand are names and shapes of objects, and colours, of pictures of each alone; the map: where fixtures stand; and
  which of several equal objects begins where, as the task's own text says. Depth is exact, joints are measured exactly,
  two fingers feel touch; nothing says which pixel is whose.
- *words* (`--sensing words`): nothing but the goal's words and the same cameras. Objects are sought by colour or by the
  plain form that its name holds; a goal with a name that holds neither is not translated, and counts as not met.

The scorer is LIBERO's predicate. Its process computes it after each session and never sends it; a line a session is
read from its file afterwards. An episode has no limit of steps, as published evaluations have (220 to 520): its
simulated time is printed instead.

Final: at the end of the goal the scorer agrees, and so does the verdict. First: the same without a second session of
any node. False success: a verdict `success` where the scorer disagrees at the end. Each episode is one line of the
results file: a run resumes where it stopped. The last line is JSON.
"""

import argparse
import json
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.libero_parts.served import Server, serve
from benchmarks.libero_parts.tasks import open_workspace, read_profile, write_project, write_project_of_words
from benchmarks.runner import finish
from phyagentos.agent.mission.report import MissionReport
from phyagentos.agent.repair.looking import propose_looking
from phyagentos.agent.repair.recovery_policies import GraphRepair, RepairPolicy
from phyagentos.agent.repair.retrying import propose_retry
from phyagentos.assembly.agent_plane import Agent, MemoryUse
from phyagentos.bench.report import Rate, Threshold
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.perception import Prior, Sensing
from phyagentos.protocol.settings.settings_files import declare

SUITES = ("libero_spatial", "libero_object", "libero_goal", "libero_10")
PRO = tuple(f"libero_{suite}_{kind}" for suite in ("spatial", "object", "goal") for kind in ("swap", "task"))
TASKS, STATES = 10, 5
WORDS = "words"
SENSINGS = {"state": Sensing.TRUTH, "perceived": Sensing.PERCEIVED, WORDS: Sensing.PERCEIVED}
ASKED = {
    "libero_spatial_final": Threshold(0.9, at_least=True),
    "libero_object_final": Threshold(0.9, at_least=True),
    "libero_goal_final": Threshold(0.75, at_least=True),
    "libero_10_final": Threshold(0.75, at_least=True),
    "libero_pro_final": Threshold(0.533, at_least=True),
    "false_success_rate": Threshold(0.01, at_least=False),
}

BUILTIN, LEARNED = "builtin skills", "a learned skill where something is put"
SAME_SKILL = GraphRepair((propose_looking, propose_retry))  # a learned one is not rescued by others
Record = dict[str, Any]
Key = tuple[str, int, int]


def main() -> int:
    """Run what is missing, show everything, and exit with whether every asked figure holds."""
    given = parse_arguments()
    console = Console(stderr=True)
    of = {"sensing": given.sensing, "skills": LEARNED if given.policy else BUILTIN}
    known = read_results(given.results, of)
    for task in () if given.show else given.tasks:
        for suite in given.suites:
            states = [state for state in given.states if (suite, task, state) not in known]
            for record in run_task(given, suite, task, states) if states else ():
                record |= of
                with given.results.open("a") as results:
                    results.write(json.dumps(record) + "\n")
                known[suite, task, record["state"]] = record
                told = f"{suite}/{task} from {record['state']}: {record['verdict']}, scorer {record['success']}"
                console.print(f"{told}, {record['sessions']} sessions, {record['wall_s']:.0f} s", highlight=False)
    keys = list(product(given.suites, given.tasks, given.states))
    chosen = [known[key] for key in keys if key in known]
    show(Console(), chosen, given.suites, of)
    figures = compute_figures(chosen) | {"missing": len(keys) - len(chosen)}
    asked = {name: ask for name, ask in ASKED.items() if name in figures} | {"missing": Threshold(0.0, at_least=False)}
    return finish(figures, asked)


def parse_arguments() -> argparse.Namespace:
    """What is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", type=Path, default=Path("build/libero/bin/python"))
    parser.add_argument("--suites", nargs="+", default=list(SUITES), help="`pro` stands for those of LIBERO-PRO")
    parser.add_argument("--sensing", choices=SENSINGS, default="state")
    parser.add_argument("--show", action="store_true", help="run nothing, show the figures of the results")
    parser.add_argument("--tasks", type=int, nargs="+", default=list(range(TASKS)))
    parser.add_argument("--states", type=int, nargs="+", default=list(range(STATES)), help="official initial states")
    parser.add_argument(
        "--results", type=Path, required=True, help="one JSON line an episode; what stands there is kept"
    )
    parser.add_argument("--policy", default="", help="endpoint of a policy that puts what is put: openpi://host:port")
    parser.add_argument("--keep", type=Path, help="folder for projects and workspaces, kept afterwards")
    given = parser.parse_args()
    if given.suites == ["pro"]:
        given.suites = list(PRO)
    return given


def read_results(path: Path, of: Record) -> dict[Key, Record]:
    """Episodes of this sensing and these skills that ended before; a line that a kill cut off is run again."""
    known: dict[Key, Record] = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            record = json.loads(line)
            if {"sensing": "state", "skills": BUILTIN} | record == record | of:
                known[record["suite"], record["task"], record["state"]] = record
        except (ValueError, KeyError):
            continue
    return known


def run_task(given: argparse.Namespace, suite: str, task: int, states: Sequence[int]) -> Iterator[Record]:
    """Episodes of one task, each as it ended."""
    folder = (given.keep or given.results.with_suffix(".work")) / f"{suite}_{task}"
    folder.mkdir(parents=True, exist_ok=True)
    scene = f"{suite}/{task}"
    try:
        outcomes, draws = folder / "outcomes.jsonl", SENSINGS[given.sensing] is Sensing.PERCEIVED
        with serve(given.python.absolute(), read_profile(), scene, outcomes, draws=draws) as server:
            told = server.describe(read_profile(), scene=scene, looks=given.sensing == "perceived")
            try:
                if given.sensing == WORDS:
                    graph = write_project_of_words(folder / "project", scene, told, server)
                else:
                    graph = write_project(folder / "project", scene, told, server, given.policy)
            except DefinitionError as error:
                for state in states:
                    yield _begin_record(suite, task, state) | {"verdict": "untranslated", "reason": str(error)}
                return
            prior, repair = Prior.NONE if given.sensing == WORDS else None, SAME_SKILL if given.policy else None
            with open_agent(folder, server, SENSINGS[given.sensing], repair, prior) as agent:
                for state in states:
                    began_s = time.perf_counter()
                    report = agent.mission.run(graph, seed=state, goal=GoalId(f"{graph.stem}-{state}"))
                    record = score(_begin_record(suite, task, state), report, server)
                    yield record | {"wall_s": round(time.perf_counter() - began_s, 1)}
    finally:
        if given.keep is None:
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def open_agent(
    folder: Path,
    server: Server,
    sense: Sensing = Sensing.TRUTH,
    repair: RepairPolicy | None = None,
    prior: Prior | None = None,
) -> Iterator[Agent]:
    """Both planes in a fresh workspace; what one episode teaches does not help the next."""
    number = sum(1 for _ in folder.glob("w*"))
    workspace = open_workspace(folder / f"w{number}", folder / "project", server)
    declare(workspace.perception, prior=prior)
    with open_bench(workspace, SystemClock(), sense=sense, memory_use=MemoryUse.NONE, policy=repair) as agent:
        yield agent


def score(record: Record, report: MissionReport, server: Server) -> Record:
    """The verdict beside what the scorer said at the end of the last session."""
    lines = server.read_outcomes()
    scored = sorted((lines[each.id] for each in report.sessions if each.id in lines), key=lambda line: line["steps"])
    return record | {
        "verdict": report.verdict,
        "reason": report.reason,
        "success": bool(scored and scored[-1]["success"]),
        "reached": any(each["reached"] for each in scored),
        "is_first": report.replans == 0 and all(report.first_attempt_success.values()),
        "steps": scored[-1]["steps"] if scored else 0,
        "sessions": len(report.sessions),
        "sim_s": round(sum(each.sim_time_s for each in report.sessions), 2),
        "ended": [
            f"{each.node}: {each.verdict or each.state} {each.cause} {each.code} {each.leaf}"
            for each in report.sessions
        ],
    }


def _begin_record(suite: str, task: int, state: int) -> Record:
    none = {
        "success": False,
        "reached": False,
        "is_first": False,
        "steps": 0,
        "sessions": 0,
        "sim_s": 0.0,
        "wall_s": 0.0,
    }
    return {"suite": suite, "task": task, "state": state, **none, "ended": []}


def is_final(record: Record) -> bool:
    """Whether scorer and verdict both say that the goal is met."""
    return bool(record["success"]) and record["verdict"] == "success"


def compute_figures(records: Sequence[Record]) -> dict[str, float]:
    """Shares by suite, and of false successes and failures over all."""
    figures: dict[str, float] = {}
    groups = {suite: (suite,) for suite in dict.fromkeys(record["suite"] for record in records)}
    for name, suites in (groups | {"libero_pro": PRO}).items():
        if of := [record for record in records if record["suite"] in suites]:
            figures[f"{name}_episodes"] = len(of)
            figures[f"{name}_final"] = sum(map(is_final, of)) / len(of)
            figures[f"{name}_first"] = sum(is_final(each) and each["is_first"] for each in of) / len(of)
    said = [record for record in records if record["verdict"] == "success"]
    figures["false_success_rate"] = (
        sum(not each["success"] for each in said) / len(records) if records else float("nan")
    )
    figures["false_failures"] = sum(each["success"] and each["verdict"] != "success" for each in records)
    return figures


def show(console: Console, records: Sequence[Record], suites: Sequence[str], of: Record) -> None:
    """A row a task, and one a suite."""
    title = f"LIBERO, {of['skills']}, sensing: {of['sensing']}"
    table = Table("task", "Final", "First", "scorer", "false success", "sim, s", title=title)
    for suite in suites:
        own = [record for record in records if record["suite"] == suite]
        for task in sorted({record["task"] for record in own}):
            table.add_row(*_describe(f"{suite}/{task}", [each for each in own if each["task"] == task]))
        if own:
            table.add_row(*_describe(suite, own, with_interval=True), style="bold", end_section=True)
    console.print(table)


def _describe(name: str, records: Sequence[Record], *, with_interval: bool = False) -> list[str]:
    finals = sum(map(is_final, records))
    firsts = sum(is_final(each) and each["is_first"] for each in records)
    falses = sum(each["verdict"] == "success" and not each["success"] for each in records)
    shares = [Rate(count, len(records)) for count in (finals, firsts, sum(each["success"] for each in records))]
    cells = [str(each) if with_interval else f"{each.successes}/{each.trials}" for each in shares]
    return [name, *cells, str(falses), f"{sum(each['sim_s'] for each in records) / len(records):.0f}"]


if __name__ == "__main__":
    sys.exit(main())
