"""Carries, shaped with casadi beside toppra's timing alone, on the same seeds: a filled cup, and heavy, smooth things.

    python benchmarks/carry_level.py --seeds 10 --grips 60

A cup goes from one coaster to the other. Both ways run through agent, journal, watchdog, worker, planner and world,
as `paos run goal_graphs/carry_cup.yaml` does. What the cup felt is computed from the recorded motion with MuJoCo and
numpy alone: the largest angle between its axis and the apparent gravity while it was carried, and how many of its
balls are no longer in it. Things that the grip just bears are carried in physics alone: see `carry_grip`.
"""

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from carry_grip import carry
from goal_time import ROOT
from scipy.signal import savgol_filter

from benchmarks.runner import finish, run, show_figures
from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Ask, Spread
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.session import GoalId

GRAPH = ROOT / "goal_graphs" / "carry_cup.yaml"
METHODS = ("casadi", "toppra")
GRAVITY = np.array([0.0, 0.0, 9.81])
WINDOW = 7  # samples that an acceleration is fitted to: encoder noise alone tilts second differences by 0.04 rad
INNER_M, RIM_M = 0.0265, 0.07  # of the cup
ASKED = {
    "casadi_worst_tilt_rad_max": Ask(0.1, at_least=False),
    "casadi_spilled": Ask(0, at_least=False),
    "casadi_goals_met": Ask(1.0, at_least=True),
    "tilt_ratio_median": Ask(0.5, at_least=False),
    "casadi_slips_share": Ask(0.02, at_least=False),
}


@dataclass(frozen=True, slots=True)
class Ride:
    """One transport: what the cup felt, what it lost, how long it took, and what the verdict was."""

    worst_tilt_rad: float
    spilled: int
    duration_s: float
    met: bool


def measure(folder: Path, met: bool) -> Ride:
    """From one evidence bundle."""
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    data = mujoco.MjData(model)
    begin_s, end_s = find_carry(folder)
    with np.load(folder / "trajectory.npz") as recorded:
        chosen = (recorded["time_s"] >= begin_s) & (recorded["time_s"] <= end_s + 0.1)
        times, joints = recorded["time_s"][chosen], recorded["q_measured"][chosen]
    positions, axes = [], []
    for q in joints:
        data.qpos[: q.size] = q
        mujoco.mj_kinematics(model, data)
        positions.append(data.site("tcp").xpos.copy())
        axes.append(-data.site("tcp").xmat.reshape(3, 3)[:, 2])
    step_s = float(np.median(np.diff(times)))
    felt = savgol_filter(positions, WINDOW, 3, deriv=2, delta=step_s, axis=0) + GRAVITY
    n = np.array(axes)
    tilt = np.arctan2(np.linalg.norm(np.cross(n, felt), axis=1), np.einsum("ij,ij->i", n, felt))
    return Ride(float(tilt.max()), count_spilled(model, folder), end_s - begin_s, met)


def find_carry(folder: Path) -> tuple[float, float]:
    """Simulated time at which the cup began and ended to be carried."""
    events = [json.loads(line) for line in (folder / "trace.jsonl").read_text().splitlines()]
    times = [event["time_s"] for event in events if event["path"].endswith("/carry")]
    return times[0], times[-1]


def count_spilled(model: mujoco.MjModel, folder: Path) -> int:
    """Balls that are not between the cup's walls at the end."""
    data = mujoco.MjData(model)
    with np.load(folder / "terminal.npz") as terminal:
        data.qpos[:] = terminal["qpos"]
    mujoco.mj_kinematics(model, data)
    rotation, origin = data.body("cup").xmat.reshape(3, 3), data.body("cup").xpos
    spilled = 0
    for name in (model.body(index).name for index in range(model.nbody)):
        if name.startswith("ball_"):
            x, y, z = rotation.T @ (data.body(name).xpos - origin)
            spilled += not (np.hypot(x, y) < INNER_M and 0.0 < z < RIM_M)
    return spilled


def main(*, seeds: int = 10, grips: int = 60) -> int:
    """Run, show, and exit with whether every asked figure holds."""
    carried = {method: [carry(seed, is_shaped=method == "casadi") for seed in range(grips)] for method in METHODS}
    rides: dict[str, list[Ride]] = {method: [] for method in METHODS}
    with tempfile.TemporaryDirectory(prefix="carry-") as scratch:
        workspace = open_project(Path(scratch) / "w", ROOT)
        with open_bench(workspace, SystemClock()) as agent:
            for seed in range(seeds):
                for method in METHODS:
                    overrides = {"sessions.cup.with.method": method}
                    goal = GoalId(f"{method}-{seed}")
                    report = agent.mission.run(GRAPH, seed=seed, overrides=overrides, goal=goal)
                    folder = workspace.evidence_of(report.sessions[0].id)
                    rides[method].append(measure(folder, report.verdict == "success" and len(report.sessions) == 1))
    ratios = [a.worst_tilt_rad / b.worst_tilt_rad for a, b in zip(rides["casadi"], rides["toppra"], strict=True)]
    figures = {
        "casadi_worst_tilt_rad_max": max(ride.worst_tilt_rad for ride in rides["casadi"]),
        "toppra_worst_tilt_rad_max": max(ride.worst_tilt_rad for ride in rides["toppra"]),
        "casadi_spilled": float(sum(ride.spilled for ride in rides["casadi"])),
        "toppra_spilled": float(sum(ride.spilled for ride in rides["toppra"])),
        "casadi_goals_met": sum(ride.met for ride in rides["casadi"]) / seeds,
        "toppra_goals_met": sum(ride.met for ride in rides["toppra"]) / seeds,
        "tilt_ratio_median": float(np.median(ratios)),
        "casadi_slips_share": sum(c.slipped for c in carried["casadi"]) / grips,
        "toppra_slips_share": sum(c.slipped for c in carried["toppra"]) / grips,
        "casadi_slip_median_mm": 1e3 * float(np.median([c.slip_m for c in carried["casadi"]])),
        "toppra_slip_median_mm": 1e3 * float(np.median([c.slip_m for c in carried["toppra"]])),
        "seeds": float(seeds),
        "grips": float(grips),
    }
    for method in METHODS:
        figures[f"{method}_s_median"] = Spread.of([ride.duration_s for ride in rides[method]]).median
        figures[f"{method}_grip_s_median"] = Spread.of([c.duration_s for c in carried[method]]).median
    title = "an open cup, carried 0.44 m; objects of nine tenths of what the grip bears, carried anywhere"
    show_figures(title, figures, ASKED)
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
