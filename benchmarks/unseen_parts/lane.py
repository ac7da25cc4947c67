"""One lane: a process with one warm runtime plane that runs goals in order, and tells its parent line by line.

    python -m benchmarks.unseen_parts.lane FOLDER TABLE SENSE SEED...

The parent ends a lane in which a goal hangs; what dies or raises is a crash of the goal that had begun.
"""

import json
import os
import sys
import time
import traceback
from dataclasses import replace
from pathlib import Path

import msgspec

from benchmarks.unseen_parts.cases import Case
from benchmarks.unseen_parts.files import write_project
from benchmarks.unseen_parts.goals import draw_case
from benchmarks.unseen_parts.records import Recorder, begin_record
from phyagentos.assembly.agent_plane import Agent, MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.workspace import Workspace

FRICTION = {"unseen": (0.2, 0.6), "slick": (0.1, 0.1), "grippy": (1.0, 1.0)}


def draw_table(seed: int, table: str) -> Case:
    """The case of a seed in one of the tables."""
    return draw_case(seed, friction=FRICTION[table])


def run_lane(folder: Path, table: str, sense: str, seeds: list[int]) -> None:
    """Run the goals of these seeds; one line before and one after each."""
    cases = [draw_table(seed, table) for seed in seeds]
    project = folder / "project"
    write_project(cases, project)
    workspace = open_project(folder / "workspace", project)
    bench = open_bench(
        workspace,
        SystemClock(),
        faults=project / "faults" / "unseen.yaml",
        sense=Sensing(sense),
        memory_use=MemoryUse.NONE,  # goals are independent trials: what one teaches would help the next
    )
    with bench as agent:
        for case in cases:
            tell({"begun": case.seed})
            tell({"done": run_case(agent, workspace, project, case, table)})


def run_case(agent: Agent, workspace: Workspace, project: Path, case: Case, table: str) -> object:
    """One goal, judged; what it raises is told as a crash."""
    begun_s, logs = time.perf_counter(), measure_logs(workspace)
    try:
        graph = project / "goal_graphs" / f"{case.name}.yaml"
        report = agent.mission.run(graph, seed=case.seed, goal=GoalId(case.name))
        wall_s = time.perf_counter() - begun_s
        recorder = Recorder(case, table, workspace.evidence, msgspec.to_builtins(report))
        record = recorder.record(wall_s)
        if fallen := read_traceback(workspace, logs):  # of a worker, a world or the watchdog
            record = replace(record, ended="crashed", error=fallen)
        return record.as_json()
    except Exception:  # every one is a finding
        return begin_record(case, table, ended="crashed", error=traceback.format_exc()).as_json()


def measure_logs(workspace: Workspace) -> dict[Path, int]:
    """How long the logs of the processes are."""
    return {path: path.stat().st_size for path in workspace.logs.glob("*.log")}


def read_traceback(workspace: Workspace, logs: dict[Path, int]) -> str:
    """The end of the first traceback that a process wrote since; empty without one."""
    for path in sorted(workspace.logs.glob("*.log")):
        written = path.read_bytes()[logs.get(path, 0) :].decode(errors="replace")
        if (begin := written.find("Traceback (most recent call last)")) >= 0:
            return f"{path.name}: {written[begin : begin + 4000]}"
    return ""


def tell(line: object) -> None:
    """One line for the parent."""
    print(json.dumps(line), flush=True)


def main() -> None:
    """Run; the process ends at once, whatever threads are left."""
    folder, table, sense, *seeds = sys.argv[1:]
    run_lane(Path(folder), table, sense, [int(seed) for seed in seeds])
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
