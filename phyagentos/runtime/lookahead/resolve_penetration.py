"""Resolves penetrations before simulation: a body believed inside its support is stood on it.

A solver would throw such a body away. A small thing that lies and one that stands on its rim look nearly alike, but
only one of the two fits between its support and the height at which it was seen. So it is stood on each of its sides
in turn; the side that leaves it nearest to where it was seen is believed.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

SUNK_M = 0.004  # depths and calibration err by less than this
REACH_M = 0.1  # how far above its place a side is tried
CLIMB_M = 0.015  # a thing that would have to rise by more stands beside the other one
HALVINGS = 12  # of that: a fortieth of a millimetre


def stand_up_sunk(model: mujoco.MjModel, data: mujoco.MjData, names: list[str]) -> list[str]:
    """Move the named free bodies that are sunk into others onto their support, the lowest first; names of the moved.

    No gripper may hold them; `data.qpos` is written.
    """
    moved = []
    above = sorted(names, key=lambda each: float(data.qpos[_find_start(model, each) + 2]))
    while above:
        name = above.pop(0)  # of two that are in each other the upper one gives way
        ignored = [model.body(each).id for each in above]
        if _measure_depth(model, data, name, ignored) > SUNK_M and _stand(model, data, name, ignored):
            moved.append(name)
    return moved


def _stand(model: mujoco.MjModel, data: mujoco.MjData, name: str, ignored: list[int]) -> bool:
    """Put a body on its most likely side; whether there is one."""
    start = _find_start(model, name)
    seen = np.array(data.qpos[start : start + 7])
    sides = []
    for side, quaternion in enumerate(_iter_sides(seen[3:])):
        data.qpos[start + 3 : start + 7] = quaternion
        height_m = _find_height(model, data, name, ignored, float(seen[2]))
        sides.append((abs(height_m - float(seen[2])), side, height_m, quaternion))
    climb_m, _, height_m, quaternion = min(sides, key=lambda each: each[:2])
    is_likely = climb_m <= CLIMB_M
    data.qpos[start : start + 7] = (*seen[:2], height_m, *quaternion) if is_likely else seen
    return is_likely


def _find_height(model: mujoco.MjModel, data: mujoco.MjData, name: str, ignored: list[int], seen_m: float) -> float:
    """Lowest height at which a body is in no other one, near the height at which it was seen [m]."""
    height = _find_start(model, name) + 2
    low, high = seen_m - REACH_M / 2, seen_m + REACH_M
    for _ in range(HALVINGS):
        middle = data.qpos[height] = (low + high) / 2
        is_free = _measure_depth(model, data, name, ignored) <= 0.0
        low, high = (low, middle) if is_free else (middle, high)
    return high


def _iter_sides(quaternion_wxyz: Array) -> list[Array]:
    """Turns with one of the body's axes upright, each by the least turn from the one given."""
    rotation = Rotation.from_quat(np.roll(quaternion_wxyz, -1))
    sides = []
    for axis in np.eye(3)[[2, 1, 0]]:
        now = rotation.apply(axis)
        upright = np.array([0.0, 0.0, 1.0 if now[2] >= 0.0 else -1.0])
        turn, _ = Rotation.align_vectors(upright[None], now[None])
        sides.append(np.roll((turn * rotation).as_quat(), 1))
    return sides


def _measure_depth(model: mujoco.MjModel, data: mujoco.MjData, name: str, ignored: list[int]) -> float:
    """How deep a body is in others than those ignored [m]; 0 outside of them."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    bodies = model.geom_bodyid[data.contact.geom[: data.ncon]]
    own = (bodies == model.body(name).id).any(axis=1) & ~np.isin(bodies, ignored).any(axis=1)
    return max(0.0, -float(data.contact.dist[: data.ncon][own].min(initial=0.0)))


def _find_start(model: mujoco.MjModel, name: str) -> int:
    return int(model.jnt_qposadr[model.body(name).jntadr[0]])
