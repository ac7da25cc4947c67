"""Conditions of suites beside those of the scorer `simulator`: from a recorded simulator state, MuJoCo and numpy alone.

A suite names one as `benchmarks.eyes:is_borne`; nothing of the framework that acted is imported.
"""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import yaml

from phyagentos.bench.scorers.simulator_state import is_posed, is_standing

ROBOTS = Path(__file__).resolve().parents[1] / "robots"
GAP_M = 0.006  # between what rests on each other, contact softness and a small tilt included
LEVEL_COS = 0.985  # ten degrees
BASE_JOINTS = ["base_x", "base_y", "base_yaw"]


def is_borne(folder: Path, load: str, carrier: str, half_m: Sequence[float], height_m: float) -> bool:
    """Whether the middle of `load` stands `height_m` [m] above that of a level box of these half extents (2,) [m]."""
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    data = mujoco.MjData(model)
    with np.load(folder / "terminal.npz") as terminal:
        data.qpos[:] = terminal["qpos"]
    mujoco.mj_kinematics(model, data)
    rotation = data.body(carrier).xmat.reshape(3, 3)
    place = rotation.T @ (data.body(load).xpos - data.body(carrier).xpos)
    is_over = abs(place[0]) <= half_m[0] and abs(place[1]) <= half_m[1]
    return bool(rotation[2, 2] > LEVEL_COS and is_over and abs(place[2] - height_m) <= GAP_M)


def is_in_posture(folder: Path, robot: str, posture: str, held_s: float = 0.9, still_rad_s: float = 0.05) -> bool:
    """Whether a robot ended in a posture that its profile names, and was measured there for some time before."""
    profile = yaml.safe_load((ROBOTS / robot / "target.yaml").read_text())
    joints = [name for name in profile["arm"]["joints"] if name not in BASE_JOINTS]
    return is_posed(folder, dict(zip(joints, profile["postures"][posture], strict=True)), held_s, still_rad_s)


def is_kept(folder: Path, robot: str, posture: str, body: str, least_m: float) -> bool:
    """Whether a posture was kept for ten seconds by a robot that is pushed, which stands at its height at the end."""
    return is_in_posture(folder, robot, posture, 9.9, 0.2) and is_standing(folder, body, least_m)


def is_within(folder: Path, thing: str, middle_m: Sequence[float], half_m: Sequence[float]) -> bool:
    """Whether the origin of a free body is within a box (3,) along the axes of the world."""
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    start = int(model.jnt_qposadr[model.body(thing).jntadr[0]])
    with np.load(folder / "terminal.npz") as terminal:
        at_m = terminal["qpos"][start : start + 3]
    return bool((np.abs(at_m - middle_m) <= half_m).all())
