"""Says from a recorded simulator state whether a cube lies in a tray, and the like.

It loads `scene.mjb` and `terminal.npz` with MuJoCo and numpy alone; nothing of the framework that acted is imported.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

RIM_MARGIN_M = 0.002
REST_SPEED_M_S = 0.05
FLOOR_SLACK_M = 0.004
POSED_RAD, POSED_S, REST_RAD_S = 0.05, 0.9, 0.05  # of a posture: how near, how long before the end, how still


def is_in_tray(folder: Path, cube: str, tray: str) -> bool:
    """Whether the centre of `cube` is between the walls of `tray`, under its rim, and at rest.

    Args:
        folder: An evidence bundle.
        cube: Body name of a free body.
        tray: Body name of a body made of boxes.
    """
    model, data = _read_end(folder)
    cube_id, tray_id = model.body(cube).id, model.body(tray).id
    lower, upper = _compute_box(model, tray_id)
    rotation = data.xmat[tray_id].reshape(3, 3)
    position = rotation.T @ (data.xpos[cube_id] - data.xpos[tray_id])
    dof = model.body_dofadr[cube_id]
    at_rest = float(np.linalg.norm(data.qvel[dof : dof + 3])) < REST_SPEED_M_S
    inside = bool(np.all(position[:2] > lower[:2]) and np.all(position[:2] < upper[:2]))
    half_m = float(model.geom_size[model.body_geomadr[cube_id]].min())
    low_enough = position[2] - half_m < upper[2] - RIM_MARGIN_M
    return inside and bool(low_enough) and bool(position[2] > lower[2]) and at_rest


def is_in_place(folder: Path, thing: str, place: str, center_m: Sequence[float], half_m: Sequence[float]) -> bool:
    """Whether the box of a free body lies at rest in the interior of a place, on its floor.

    Args:
        folder: An evidence bundle.
        thing: Body name of a free body whose first geometry is a box.
        place: Body name of a body with an interior.
        center_m: (3,) middle of the interior in the frame of the place [m].
        half_m: (3,) half extents of the interior [m].
    """
    model, data = _read_end(folder)
    body, base, half = model.body(thing), model.body(place), np.array(half_m)
    geom, dof = body.geomadr[0], body.dofadr[0]
    corners = np.array(np.meshgrid(*([-1, 1],) * 3)).reshape(3, 8) * model.geom_size[geom][:, None]
    world = data.geom_xpos[geom][:, None] + data.geom_xmat[geom].reshape(3, 3) @ corners
    local = data.xmat[base.id].reshape(3, 3).T @ (world - data.xpos[base.id][:, None]) - np.array(center_m)[:, None]
    within = np.all(np.abs(local[:2].mean(axis=1)) < half[:2])
    at_rest = np.linalg.norm(data.qvel[dof : dof + 3]) < REST_SPEED_M_S
    return bool(within and -half[2] - FLOOR_SLACK_M < local[2].min() < half[2] and at_rest)


def is_posed(
    folder: Path, posture_rad: Mapping[str, float], held_s: float = POSED_S, still_rad_s: float = REST_RAD_S
) -> bool:
    """Whether every joint is at its place [rad] and at rest at the end, and was measured there for some time before.

    Args:
        folder: An evidence bundle.
        posture_rad: By name of a joint, in the order of the recorded trajectory.
        held_s: That time [s].
        still_rad_s: How fast a joint at rest may be; one that is pushed sways [rad/s].
    """
    if not (folder / "terminal.npz").exists():
        return False
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    joints, wanted = [model.joint(name) for name in posture_rad], np.array(list(posture_rad.values()))
    with np.load(folder / "terminal.npz") as terminal, np.load(folder / "trajectory.npz") as course:
        q = terminal["qpos"][[int(joint.qposadr[0]) for joint in joints]]
        qd = terminal["qvel"][[int(joint.dofadr[0]) for joint in joints]]
        late = course["time_s"] >= course["time_s"][-1] - held_s
        rows = np.vstack((course["q_measured"][late][:, -len(q) :], q))  # the pose of a base comes first
    return bool((np.abs(rows - wanted) <= POSED_RAD).all() and (np.abs(qd) <= still_rad_s).all())


def is_standing(folder: Path, body: str, least_m: float, place: str = "", ahead_m: float = 0.0) -> bool:
    """Whether a body is level within 10 degrees and at least so high at the end, at rest on feet that touch the floor.

    With a `place` it also faces that body within 6 degrees, its origin within 7 cm of `ahead_m` from its centre.
    """
    if not (folder / "terminal.npz").exists():
        return False
    model, data = _read_end(folder)
    own, R = data.body(body), data.body(body).xmat.reshape(3, 3)
    pairs = model.geom_bodyid[data.contact.geom[: data.ncon]]
    roots = {int(model.body_rootid[each]) for pair in pairs if model.body("floor").id in pair for each in pair}
    stands = R[2, 2] > np.cos(np.radians(10)) and own.xpos[2] >= least_m and model.body(body).id in roots
    still = float(np.linalg.norm(data.qvel[model.body_dofadr[model.body(body).id] :][:3])) < REST_SPEED_M_S
    if not place:
        return bool(stands and still)
    to_place = (data.body(place).xpos - own.xpos)[:2]
    turned = np.arctan2(*(R[1::-1, 0])) - np.arctan2(to_place[1], to_place[0])
    faces = abs(np.remainder(turned + np.pi, 2 * np.pi) - np.pi) < np.radians(6)
    return bool(stands and still and faces and abs(np.linalg.norm(to_place) - ahead_m) < 0.07)


def is_parked(folder: Path, body: str, mount_wxyz: Sequence[float], place: str, at_m: Sequence[float]) -> bool:
    """Whether a base is at rest within 5 cm and 6 degrees of a point (3,) of a body's frame, headed as that frame is.

    `mount_wxyz` is how the base's own frame stands in the world where it is headed along x.
    """
    if not (folder / "terminal.npz").exists():
        return False
    model, data = _read_end(folder)
    own, there, mount = data.body(body), data.body(place), np.zeros(9)
    mujoco.mju_quat2Mat(mount, np.array(mount_wxyz, dtype=float))
    turned = there.xmat.reshape(3, 3).T @ own.xmat.reshape(3, 3) @ mount.reshape(3, 3).T
    away = there.xmat.reshape(3, 3).T @ (own.xpos - there.xpos) - at_m
    still = float(np.linalg.norm(data.qvel[model.body_dofadr[model.body(body).id] :][:3])) < REST_SPEED_M_S
    return bool(still and np.linalg.norm(away[:2]) < 0.05 and turned[0, 0] > np.cos(np.radians(6)))


def is_held_up(folder: Path, thing: str, supports: Sequence[str]) -> bool:
    """Whether a free body is at rest, on none of its supports, and touched by two fingers or more.

    A finger is all that hangs on one body whose parent does not move.
    """
    if not (folder / "terminal.npz").exists():
        return False
    model, data = _read_end(folder)
    own = model.body(thing).id
    pairs = model.geom_bodyid[data.contact.geom[: data.ncon]]
    touching = {int(a if b == own else b) for a, b in pairs if own in (a, b)}
    fingers = set()
    for body in touching:
        while model.body_weldid[body] and model.body_weldid[model.body_parentid[body]]:
            body = int(model.body_parentid[body])
        fingers |= {body} if model.body_weldid[body] else set()
    dof = model.body_dofadr[own]
    at_rest = float(np.linalg.norm(data.qvel[dof : dof + 3])) < REST_SPEED_M_S
    return at_rest and len(fingers) >= 2 and not touching & {model.body(name).id for name in supports}


def _read_end(folder: Path) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The model of a bundle and its last state, with all that follows from it."""
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    data = mujoco.MjData(model)
    with np.load(folder / "terminal.npz") as terminal:
        data.qpos[:], data.qvel[:] = terminal["qpos"], terminal["qvel"]
    mujoco.mj_forward(model, data)
    return model, data


def _compute_box(model: mujoco.MjModel, body: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bounds (3,), (3,) of a body's boxes in its own frame [m]."""
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        if model.geom_contype[geom] == 0 and model.geom_conaffinity[geom] == 0:
            continue
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
        reach = np.abs(matrix.reshape(3, 3)) @ model.geom_size[geom]
        lower = np.minimum(lower, model.geom_pos[geom] - reach)
        upper = np.maximum(upper, model.geom_pos[geom] + reach)
    return lower, upper
