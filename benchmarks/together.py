"""Two robots under one goal, beside the same sessions one after the other: two arms at one heap, or a cart and an arm.

    python benchmarks/together.py --seeds 50
    python benchmarks/together.py --seeds 6 --example fetch_and_sort

Each seed runs three times: both robots at once, in turn, with an edge from each node to the next, and at once again
(its bits are compared). A cube counts when `judge.is_in_tray` says so. Makespan is simulated time from the first
snapshot to the last. Contacts between the robots are those that the world noted at every physics step; besides, the
recorded joint positions of both are put into the recorded model, which tells how near they came.
"""

import argparse
import itertools
import json
import shutil
import statistics
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import yaml
from rich.console import Console

from phyagentos.agent.mission.report import MissionReport
from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Ask, Rate, format_outcome
from phyagentos.bench.scorers.simulator_state import is_in_tray
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.targets import BASE_JOINTS
from phyagentos.protocol.workspace.workspace import Workspace

ROOT = Path(__file__).resolve().parents[1]
ARM = tuple(f"joint{k}" for k in range(1, 8))
CART = (*BASE_JOINTS, "Rotation_R", "Pitch_R", "Elbow_R", "Wrist_Pitch_R", "Wrist_Roll_R")


@dataclass(frozen=True)
class Example:
    """A folder of `examples/`: its robots with their joints, and the share of the serial makespan that is asked."""

    folder: str
    robots: Mapping[str, tuple[str, ...]]
    share: float


EXAMPLES = {
    "sort_together": Example("04_two_arms", {"left_arm": ARM, "right_arm": ARM}, 0.65),
    "fetch_and_sort": Example("07_fetch_and_sort", {"arm": ARM, "cart": CART}, 0.9),
}
NEAR_M, MOMENT_S = 0.10, 0.02


def write_serial(project: Path, name: str) -> Path:
    """The same graph with its nodes one after the other: those of one arm, then those of the other."""
    graph = project / "goal_graphs" / f"{name}.yaml"
    data = yaml.safe_load(graph.read_text())
    nodes = list(data["sessions"])
    for before, node in itertools.pairwise(nodes):
        data["sessions"][node]["after"] = [before]
    serial = graph.with_name(f"{name}_in_turn.yaml")
    serial.write_text(yaml.safe_dump(data | {"goal": serial.stem}, sort_keys=False))
    return serial


def find_bundles(workspace: Workspace, report: MissionReport) -> list[Path]:
    """Bundles of the sessions that were executed."""
    folders = [workspace.evidence_of(session.id) for session in report.sessions]
    return [folder for folder in folders if (folder / "terminal.npz").exists()]


def measure_makespan(folders: list[Path]) -> float:
    """Simulated time from the first snapshot to the last [s]."""
    began = min(float(np.load(folder / "initial.npz")["time"]) for folder in folders)
    return max(float(np.load(folder / "terminal.npz")["time"]) for folder in folders) - began


def find_contacts(folders: list[Path]) -> list[float]:
    """Forces of the contacts between the arms, as the world noted them [N]."""
    events = [json.loads(line) for folder in folders for line in (folder / "events.jsonl").read_text().splitlines()]
    return [event["details"]["force_n"] for event in events if event["kind"] == "robot_contact"]


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


def measure_distance(folders: list[Path], sessions: dict[str, str], robots: Mapping[str, tuple[str, ...]]) -> float:
    """How near the robots came, from their recorded joint positions [m]; `NEAR_M` where they were never nearer."""
    model = mujoco.MjModel.from_binary_path(str(folders[0] / "scene.mjb"))
    data = mujoco.MjData(model)
    owner = np.array(
        [
            next((i for i, robot in enumerate(robots) if model.body(body).name.startswith(f"{robot}/")), -1)
            for body in model.geom_bodyid
        ]
    )
    model.geom_margin[owner >= 0] = NEAR_M
    model.body_margin[np.unique(model.geom_bodyid[owner >= 0])] = NEAR_M
    with np.load(folders[0] / "initial.npz") as first:
        data.qpos[:] = first["qpos"]
    courses = {}
    for robot in robots:
        parts = [np.load(folder / "trajectory.npz") for folder in folders if sessions[folder.name] == robot]
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


def read_bits(folders: list[Path]) -> dict[str, bytes]:
    """Trajectories and snapshots of a run, by session and name."""
    return {
        f"{folder.name}/{file.name}": file.read_bytes() for folder in folders for file in sorted(folder.glob("*.npz"))
    }


def run(graph: Path, project: Path, seeds: range, console: Console, robots: Mapping[str, tuple]) -> dict[int, dict]:
    """What came of each seed."""
    found = {}
    cubes = {name.split()[0]: name.split()[1] for name in find_cubes(graph)}
    with tempfile.TemporaryDirectory(prefix="together-", ignore_cleanup_errors=True) as scratch:
        workspace = open_project(Path(scratch), project)
        with open_bench(workspace, SystemClock(), memory_use=MemoryUse.NONE) as agent:
            for seed in seeds:
                report = agent.mission.run(graph, seed=seed)
                folders = find_bundles(workspace, report)
                last = max(folders, key=lambda folder: float(np.load(folder / "terminal.npz")["time"]))
                owners = {workspace.evidence_of(session.id).name: session.target for session in report.sessions}
                at_home = [is_in_tray(last, *pair) for pair in cubes.items()]
                waits = sum("MOTION_CONFLICT" in str(session.code) for session in report.sessions)
                found[seed] = {
                    "met": report.verdict == "success",
                    "true": all(at_home),
                    "makespan_s": measure_makespan(folders),
                    "contacts_n": find_contacts(folders),
                    "nearest_m": measure_distance(folders, owners, robots),
                    "replans": len(report.sessions) - len({session.node for session in report.sessions}),
                    "conflicts": waits,
                    "wall_s": report.wall_s,
                    "bits": read_bits(folders),
                    "reason": report.reason,
                    "causes": [f"{s.id} {s.cause} {s.code} {s.leaf}" for s in report.sessions if s.cause],
                }
                each = found[seed]
                console.print(
                    f"{graph.stem} {seed}: {report.verdict}, {sum(at_home)} of {len(at_home)} cubes, "
                    f"{each['makespan_s']:.1f} s, {len(each['contacts_n'])} contacts, "
                    f"nearest {1e3 * each['nearest_m']:.0f} mm, "
                    f"{each['replans']} replans {each['causes']}, {report.wall_s:.0f} s of wall time",
                    "" if each["met"] else report.reason,
                )
    return found


def run_handovers(project: Path, seeds: range, console: Console) -> list[bool]:
    """Of each seed, whether the bar went from hand to hand and lies where only the right arm reaches, in truth."""
    graph, held = project / "goal_graphs" / "handover.yaml", []
    region = yaml.safe_load((project / "scenes" / "handover.yaml").read_text())["regions"]["right_place"]
    with tempfile.TemporaryDirectory(prefix="handover-", ignore_cleanup_errors=True) as scratch:
        workspace = open_project(Path(scratch), project)
        with open_bench(workspace, SystemClock(), memory_use=MemoryUse.NONE) as agent:
            for seed in seeds:
                report = agent.mission.run(graph, seed=seed)
                folders = find_bundles(workspace, report)
                model = mujoco.MjModel.from_binary_path(str(folders[0] / "scene.mjb"))
                start = int(model.joint(int(model.body("bar").jntadr[0])).qposadr[0])
                ends = [np.load(folder / "terminal.npz")["qpos"][start : start + 3] for folder in folders]
                is_there = bool((np.abs(ends[-1] - region["center_m"]) <= region["half_m"]).all())
                touched = len(find_contacts(folders))
                held.append(report.verdict == "success" and is_there and not touched)
                console.print(f"handover {seed}: {report.verdict}, bar at {ends[-1].round(3)}, {touched} contacts")
                console.print(
                    *[f"{s.id} {s.cause} {s.code} {s.leaf} {s.reason[:200]}" for s in report.sessions if s.cause]
                )
    return held


def find_cubes(graph: Path) -> list[str]:
    """`cube place` of every node that brings a cube to a place; the last of a cube is its tray."""
    nodes = yaml.safe_load(graph.read_text())["sessions"].values()
    return [
        f"{node['with']['object']} {node['with']['destination']}" for node in nodes if "destination" in node["with"]
    ]


def main() -> int:
    """Run, show, and tell whether the robots are quick together and never touch."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--example", choices=EXAMPLES, default="sort_together")
    parser.add_argument("--graph", help="another goal of the example")
    parser.add_argument("--compared", type=int, help="seeds that also run in turn; all of them by default")
    parser.add_argument("--repeated", type=int, help="seeds that also run again; those that run in turn by default")
    parser.add_argument("--handovers", type=int, default=20, help="seeds of the handover, beside sort_together")
    chosen = parser.parse_args()
    example, name = EXAMPLES[chosen.example], chosen.graph or chosen.example
    seeds, console = range(chosen.first, chosen.first + chosen.seeds), Console(highlight=False)
    with tempfile.TemporaryDirectory(prefix="project-") as folder:
        project = Path(shutil.copytree(ROOT / "examples" / example.folder, Path(folder) / "project"))
        graph = project / "goal_graphs" / f"{name}.yaml"
        together = run(graph, project, seeds, console, example.robots)
        compared = seeds[: chosen.compared]
        serial = run(write_serial(project, name), project, compared, console, example.robots) if compared else {}
        is_table = chosen.example == "sort_together"
        handed = run_handovers(project, range(chosen.handovers), console) if is_table else []
        repeated = compared if chosen.repeated is None else seeds[: chosen.repeated]
        again = run(graph, project, repeated, console, example.robots) if repeated else {}
    goals = Rate(sum(each["met"] and each["true"] for each in together.values()), len(together))
    figures = {
        "goals": goals.value,
        "false_successes": float(sum(each["met"] and not each["true"] for each in together.values())),
        "contacts": float(sum(len(each["contacts_n"]) for each in together.values())),
        "nearest_mm": 1e3 * min(each["nearest_m"] for each in together.values()),
        "makespan_s": statistics.mean(each["makespan_s"] for each in together.values()),
    }
    asked = {
        "goals": Ask(0.95, at_least=True),
        "false_successes": Ask(0, at_least=False),
        "contacts": Ask(0, at_least=False),
    }
    if compared:
        both = [seed for seed in compared if together[seed]["met"] and serial[seed]["met"]]
        figures["serial_s"] = statistics.mean(serial[seed]["makespan_s"] for seed in both)
        figures["share_of_serial"] = (
            statistics.mean(together[seed]["makespan_s"] for seed in both) / figures["serial_s"]
        )
        figures["worst_share"] = max(together[seed]["makespan_s"] / serial[seed]["makespan_s"] for seed in both)
        asked["share_of_serial"] = Ask(example.share, at_least=False)
    if repeated:
        figures["other_bits"] = float(sum(together[seed]["bits"] != again[seed]["bits"] for seed in repeated))
        asked["other_bits"] = Ask(0, at_least=False)
    if handed:
        figures["handovers"] = (rate := Rate(sum(handed), len(handed))).value
        asked["handovers"] = Ask(0.95, at_least=True)
        console.print(f"handovers: {rate}")
    console.print(f"goals met in truth: {goals}")
    line, holds = format_outcome(figures, asked)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
