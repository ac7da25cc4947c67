"""What a warm goal takes beside its physics alone: `tidy_table`, one runtime plane alone on the machine, no fault.

    python benchmarks/goal_time.py --seeds 12

The time of a goal is that from claim to finish, over its sessions; beside it stands a bare `mj_step` loop over the same
simulated time, from the recorded initial states, taken while the plane waits for the next goal, so that both see the
same machine. The first goal warms the plane up and is left out. Success is a figure of the suite `tabletop`.
"""

import tempfile
import time
from datetime import datetime
from pathlib import Path
from typing import Literal

import mujoco
from rich.console import Console

from benchmarks.runner import finish, run, show
from phyagentos.agent.mission.report import MissionReport
from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Spread, Threshold
from phyagentos.bench.scoring import measure
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.pictures.model_file import read_model
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Journal

ROOT = Path(__file__).resolve().parents[1]
GRAPH = ROOT / "goal_graphs" / "tidy_table.yaml"
ASKED = {
    "goal_over_physics_alone_median": Threshold(3.0, at_least=False),
    "planning_per_pick_and_place_s_median": Threshold(0.10, at_least=False),
}


def time_physics(workspace: Workspace, report: MissionReport) -> float:
    """Wall time of a bare `mj_step` loop over the simulated time of a goal's sessions [s]."""
    spent_s = 0.0
    for session in report.sessions:
        folder = workspace.evidence_of(session.id)
        model = read_model(folder / "scene.mjb")
        data = mujoco.MjData(model)
        initial, terminal = read_arrays(folder / "initial.npz"), read_arrays(folder / "terminal.npz")
        mujoco.mj_setState(model, data, initial["state"], mujoco.mjtState.mjSTATE_INTEGRATION)
        steps = round(float(terminal["time"] - initial["time"]) / model.opt.timestep)
        began_s = time.perf_counter()
        for _ in range(steps):
            mujoco.mj_step(model, data)
        spent_s += time.perf_counter() - began_s
    return spent_s


def time_goals(workspace: Workspace) -> dict[str, float]:
    """Seconds between claim and finish, summed over the sessions of a goal, from the journal."""
    journal = Journal(workspace.root, side=Side.OPERATOR, by="bench", clock=SystemClock())
    claimed: dict[str, datetime] = {}
    spent_s: dict[str, float] = {}
    for record in journal.read_new():
        at = datetime.fromisoformat(record.at)
        if record.ev == "claim":
            claimed[record.id] = at
        elif record.ev == "finish":
            goal = record.id.split(".")[0]
            spent_s[goal] = spent_s.get(goal, 0.0) + (at - claimed[record.id]).total_seconds()
    journal.close()
    return spent_s


def main(*, seeds: int = 12, sense: Literal["perceived", "truth"] = "perceived") -> int:
    """Run, show, and exit with whether every asked figure holds."""
    physics_s: dict[str, float] = {}
    stages: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory(prefix="goal-time-") as scratch:
        workspace = open_project(Path(scratch), ROOT)
        with open_bench(workspace, SystemClock(), sense=Sensing(sense)) as agent:
            for seed in range(seeds):
                report = agent.mission.run(GRAPH, seed=seed)
                physics_s[report.goal] = time_physics(workspace, report)
                for session in report.sessions:
                    for stage, ms in measure(workspace.evidence_of(session.id))[0].items():
                        stages.setdefault(stage, []).append(ms)
                Console(stderr=True).print(f"seed {seed}: {report.verdict}", style="dim")
        goals_s = dict(list(time_goals(workspace).items())[1:])
    spreads = {
        "goal, claim to finish": [1e3 * value for value in goals_s.values()],
        "goal, physics alone": [1e3 * physics_s[goal] for goal in goals_s],
        **{f"session: {stage}": stages[stage] for stage in sorted(stages)},
    }
    spent = ((name, Spread.of(values)) for name, values in spreads.items())
    rows = ((name, each.count, f"{each.median:.2f}", f"{each.p95:.2f}") for name, each in spent)
    show("where the time goes [ms]", ("", "count", "median", "95 %"), rows)
    figures = {
        "goal_runtime_s_median": Spread.of([*goals_s.values()]).median,
        "goal_over_physics_alone_median": Spread.of([goals_s[goal] / physics_s[goal] for goal in goals_s]).median,
        "planning_per_pick_and_place_s_median": Spread.of([ms / 1e3 for ms in stages["planning"]]).median,
        "seeds": float(seeds),
    }
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
