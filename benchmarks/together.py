"""What two robots under one goal gain in time, and how near they come: measured on a run of a suite.

    paos bench run two_arms --run runs/two_arms-1         # or fetch_and_sort
    python benchmarks/together.py runs/two_arms-1

Makespan is simulated time from the first snapshot to the last, both robots at once beside the same sessions in turn, of
the seeds that both met. The recorded joint positions of both robots are put into the recorded model, which tells how
near they came. Success, contacts and bits are figures of the suite.
"""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import mujoco
import numpy as np
import yaml
from typer import Argument, BadParameter

from benchmarks.runner import finish, run, show
from phyagentos.bench.records import EpisodeRecord, read_records
from phyagentos.bench.report import Threshold
from phyagentos.pictures.model_file import read_model
from phyagentos.protocol.capabilities.targets import BASE_JOINTS
from phyagentos.protocol.workspace.array_files import read_arrays

ARM = tuple(f"joint{k}" for k in range(1, 8))
CART = (*BASE_JOINTS, "Rotation_R", "Pitch_R", "Elbow_R", "Wrist_Pitch_R", "Wrist_Roll_R")


@dataclass(frozen=True)
class Example:
    """The robots of a task with their joints, and the share of the serial makespan that is asked."""

    robots: Mapping[str, tuple[str, ...]]
    share: float


EXAMPLES = {
    "sort_together": Example({"left_arm": ARM, "right_arm": ARM}, 0.65),
    "fetch_and_sort": Example({"arm": ARM, "cart": CART}, 0.9),
}
NEAR_M, MOMENT_S = 0.10, 0.02


def measure_makespan(folders: Sequence[Path]) -> float:
    """Simulated time from the first snapshot to the last [s]."""
    began = min(float(read_arrays(folder / "initial.npz")["time"]) for folder in folders)
    return max(float(read_arrays(folder / "terminal.npz")["time"]) for folder in folders) - began


def write_joints(
    model: mujoco.MjModel, data: mujoco.MjData, robot: str, joints: tuple[str, ...], q: np.ndarray
) -> None:
    """Put a robot into a posture (n_joints,); one with a base stands level, at the height at which it stands."""
    if joints[: len(BASE_JOINTS)] == BASE_JOINTS:
        start = int(model.joint(f"{robot}/base").qposadr[0])
        home = model.qpos0[start + 3 : start + 7]  # with a heading of zero
        data.qpos[start : start + 2] = q[:2]
        mujoco.mju_mulQuat(data.qpos[start + 3 : start + 7], (np.cos(q[2] / 2), 0.0, 0.0, np.sin(q[2] / 2)), home)
        joints, q = joints[len(BASE_JOINTS) :], q[len(BASE_JOINTS) :]
    data.qpos[[int(model.joint(f"{robot}/{name}").qposadr[0]) for name in joints]] = q


def measure_distance(
    folders: Sequence[Path], owners: Mapping[Path, str], robots: Mapping[str, tuple[str, ...]]
) -> float:
    """How near the robots came, from their recorded joint positions [m]; `NEAR_M` where they were never nearer."""
    model = read_model(folders[0] / "scene.mjb")
    data = mujoco.MjData(model)
    owner = np.array(
        [
            next((i for i, robot in enumerate(robots) if model.body(body).name.startswith(f"{robot}/")), -1)
            for body in model.geom_bodyid
        ]
    )
    model.geom_margin[owner >= 0] = NEAR_M
    model.body_margin[np.unique(model.geom_bodyid[owner >= 0])] = NEAR_M
    data.qpos[:] = read_arrays(folders[0] / "initial.npz")["qpos"]
    courses = {}
    for robot in robots:
        parts = [read_arrays(folder / "trajectory.npz") for folder in folders if owners[folder] == robot]
        if not parts:  # it stood where it began
            continue
        times = np.concatenate([part["time_s"] for part in parts])
        order = np.argsort(times, kind="stable")
        courses[robot] = times[order], np.concatenate([part["q_measured"] for part in parts])[order]
    moments = np.arange(min(t[0] for t, _ in courses.values()), max(t[-1] for t, _ in courses.values()), MOMENT_S)
    nearest = NEAR_M
    for moment in moments:
        for robot, (times, q_rad) in courses.items():
            row = max(int(np.searchsorted(times, moment, side="right")) - 1, 0)
            write_joints(model, data, robot, robots[robot], q_rad[row])
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        sides = owner[data.contact.geom]
        between = (sides.min(axis=1) >= 0) & (sides[:, 0] != sides[:, 1])
        nearest = min(nearest, float(data.contact.dist[between].min(initial=NEAR_M)))
    return nearest


def list_bundles(run: Path, record: EpisodeRecord) -> list[Path]:
    """Bundles of the sessions of an episode that were executed."""
    folders = [run / session.bundle for session in record.sessions]
    return [folder for folder in folders if (folder / "terminal.npz").exists()]


def find_owner(folder: Path) -> str:
    """The robot of a session, as its contract names it."""
    return str(yaml.load((folder / "contract.yaml").read_text(), Loader=yaml.CSafeLoader)["session"]["target"])


def main(run: Annotated[Path, Argument(help="folder of a run of two_arms or fetch_and_sort")]) -> int:
    """Measure, show, and tell whether the robots are quick together."""
    records = [record for record in read_records(run) if record.ended == "over"]
    if not records or records[0].task not in EXAMPLES:
        found = records[0].task if records else "no episode that ended"
        raise BadParameter(f"{run} holds {found}; expected a run of {' or '.join(EXAMPLES)}")
    example = EXAMPLES[records[0].task]
    spans: dict[str, dict[int, float]] = {"together": {}, "in_turn": {}}
    nearest: dict[int, float] = {}
    for record in records:
        way = record.setting or record.phase
        folders = list_bundles(run, record)
        if way in spans and record.is_met and record.verdict == "success":
            spans[way][record.seed] = measure_makespan(folders)
        if way == "together" and folders:
            nearest[record.seed] = measure_distance(
                folders, {each: find_owner(each) for each in folders}, example.robots
            )
    together, in_turn = spans["together"], spans["in_turn"]
    rows = (
        (seed, *(f"{times[seed]:.1f}" if seed in times else "-" for times in spans.values()), f"{1e3 * near_m:.0f}")
        for seed, near_m in sorted(nearest.items())
    )
    show(records[0].task, ("seed", "together, s", "in turn, s", "nearest, mm"), rows)
    both = sorted(together.keys() & in_turn.keys())
    figures = {
        "nearest_mm": 1e3 * min(nearest.values()),
        "makespan_s": statistics.mean(together.values()),
        "serial_s": statistics.mean(in_turn[seed] for seed in both),
        "share_of_serial": sum(together[seed] for seed in both) / sum(in_turn[seed] for seed in both),
        "worst_share": max(together[seed] / in_turn[seed] for seed in both),
        "pairs": float(len(both)),
    }
    return finish(figures, {"share_of_serial": Threshold(example.share, at_least=False)})


if __name__ == "__main__":
    run(main)
