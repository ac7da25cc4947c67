"""A gripper of two fingers, guessed from the solids of a model: its drive, its pads, and the frame of the tool."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_quaternion

Array = NDArray[np.float64]
Placed = tuple[Array, tuple[float, float, float, float]]  # position (3,) [m], quaternion wxyz
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
TIP_M, PAD_M, PROUD_M = (
    0.03,
    (0.01, 0.004, 0.01),
    0.001,
)  # of a finger that grips; half a pad, and how far it stands out
FAR_M = 1.0


@dataclass(frozen=True, slots=True)
class HandDraft:
    """Two fingers that close on each other; poses are in the frame of the body that carries them.

    Attributes:
        joints: What the drive moves.
        travel: Metres of opening a unit of each.
        pads: Body and pose of each pad.
        tool: On the arm's last link.
        palm_m: From the tool centre point back to the solids between the fingers.
        tip_m: From the tool centre point to the end of the fingers.
    """

    joints: tuple[str, ...]
    travel: tuple[float, ...]
    pads: tuple[tuple[str, Placed], ...]
    tool: Placed
    palm_m: float
    tip_m: float


def draft_hand(model: mujoco.MjModel, last: int, fingers: Sequence[int]) -> HandDraft | None:
    """The gripper at a body, of joints below it; None unless two branches with solids close on each other."""
    tops = {_find_top(model, int(model.jnt_bodyid[joint]), last) for joint in fingers}
    solid, data = (model.geom_contype | model.geom_conaffinity) > 0, mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    for top in sorted(tops):
        bodies = [body for body in range(model.nbody) if _is_below(model, body, top)]
        held = np.flatnonzero(solid & np.isin(model.geom_bodyid, bodies))
        if len(held):
            corners = np.vstack([_list_corners(model, data, int(geom)) for geom in held])
            away = float(np.linalg.norm(corners - data.xpos[last], axis=1).max())
            found.append((away, held, next(j for j in fingers if int(model.jnt_bodyid[j]) in bodies)))
    if len(tops) not in {2, 4} or len(found) < 2:
        return None  # of four, two are the inner bars of linkages
    found = sorted(found, key=lambda each: -each[0])[:2]
    geoms, drives = [each[1] for each in found], [each[2] for each in found]

    def measure(ends: tuple[int, ...]) -> float:
        _pose(model, data, drives, [float(model.jnt_range[j][end]) for j, end in zip(drives, ends, strict=True)])
        gaps = (mujoco.mj_geomDistance(model, data, a, b, FAR_M, None) for a in geoms[0] for b in geoms[1])
        return float(min(gaps))

    wide = max(itertools.product((0, 1), repeat=2), key=measure)
    narrow_m, wide_m = measure((1 - wide[0], 1 - wide[1])), measure(wide)
    if wide_m - max(narrow_m, 0.0) < PAD_M[1]:
        return None
    slides = int(model.jnt_type[drives[0]]) == SLIDE
    shares = [1.0 if slides else (wide_m - narrow_m) / 2 / float(np.ptp(model.jnt_range[joint])) for joint in drives]
    travel = tuple(share * (2 * end - 1) for share, end in zip(shares, wide, strict=True))
    return _place_pads(model, data, last, drives, geoms, travel)


def find_flange(model: mujoco.MjModel, chain: Sequence[int]) -> Placed:
    """Where the last link of an arm carries a hand: at its end along its axis, away from the joint before."""
    joint, data = chain[-1], mujoco.MjData(model)
    last = int(model.jnt_bodyid[joint])
    mujoco.mj_kinematics(model, data)
    held = [body for body in range(model.nbody) if model.body_weldid[body] == model.body_weldid[last]]
    ends = [_list_corners(model, data, geom) for geom in range(model.ngeom) if int(model.geom_bodyid[geom]) in held]
    z, anchor, before = (
        np.array(each) for each in (data.xaxis[joint], data.xanchor[joint], data.xanchor[chain[-2:][0]])
    )
    along = (np.vstack((data.xpos[held], *ends)) - before) @ z
    z, end_m = (z, along.max()) if along.max() >= -along.min() else (-z, -along.min())
    y = np.cross(z, np.eye(3)[int(np.abs(z).argmin())])
    y /= np.linalg.norm(y)
    return _express(
        data, last, anchor + z * float(end_m - (anchor - before) @ z), np.column_stack((np.cross(y, z), y, z))
    )


def _place_pads(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    last: int,
    drives: Sequence[int],
    geoms: Sequence[NDArray[np.intp]],
    travel: tuple[float, ...],
) -> HandDraft:
    """Pads at the inner sides of the tips, in the pose of `data`, which is wide open."""
    clouds = [np.vstack([_list_corners(model, data, int(geom)) for geom in each]) for each in geoms]
    middles = [(cloud.min(axis=0) + cloud.max(axis=0)) / 2 for cloud in clouds]
    closing = (middles[1] - middles[0]) / np.linalg.norm(middles[1] - middles[0])
    approach = (middles[0] + middles[1]) / 2 - data.xpos[last]
    approach -= closing * (approach @ closing)
    approach /= np.linalg.norm(approach)
    R = np.column_stack((np.cross(closing, approach), closing, approach))
    end = min(float((cloud @ approach).max()) for cloud in clouds)
    depth, faces, across = end - PAD_M[2] - 0.002, [], []
    for cloud, side in zip(clouds, (1.0, -1.0), strict=True):
        tip = cloud[cloud @ approach > end - TIP_M] @ R
        faces.append(side * float((side * tip[:, 1]).max()))
        across.append(float(tip[:, 0].min() + tip[:, 0].max()) / 2)
    pads = []
    for geom, face, side in zip(geoms, faces, (1.0, -1.0), strict=True):
        body = int(max(model.geom_bodyid[geom]))  # the farthest one out
        place = R @ np.array((float(np.mean(across)), face - side * (PAD_M[1] - PROUD_M), depth))
        pads.append((model.body(body).name, _express(data, body, place, R)))
    tool = R @ np.array((float(np.mean(across)), float(np.mean(faces)), depth))
    held = [
        geom for geom in range(model.ngeom) if model.body_weldid[model.geom_bodyid[geom]] == model.body_weldid[last]
    ]
    palm = max((float((_list_corners(model, data, geom) @ approach).max()) for geom in held), default=depth - TIP_M)
    names = tuple(model.joint(joint).name for joint in drives)
    return HandDraft(names, travel, tuple(pads), _express(data, last, tool, R), depth - palm, end - depth)


def _express(data: mujoco.MjData, body: int, place: Array, R: Array) -> Placed:
    frame = data.xmat[body].reshape(3, 3)
    return frame.T @ (place - data.xpos[body]), compute_quaternion(frame.T @ R)


def _find_top(model: mujoco.MjModel, body: int, last: int) -> int:
    """The body nearest to `last` that a joint moves, on the way from it to `body`."""
    found = body
    while body not in {0, last}:
        found = body if model.body_jntnum[body] else found
        body = int(model.body_parentid[body])
    return found


def _is_below(model: mujoco.MjModel, body: int, top: int) -> bool:
    while body > top:
        body = int(model.body_parentid[body])
    return body == top


def _pose(model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[int], positions: Sequence[float]) -> None:
    """Set joints, and those that are coupled to them."""
    mujoco.mj_resetData(model, data)
    for joint, position in zip(joints, positions, strict=True):
        data.qpos[model.jnt_qposadr[joint]] = position
    for _ in range(2):
        for index in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)):
            follower, leader = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
            if follower not in joints:
                value = data.qpos[model.jnt_qposadr[leader]] if leader >= 0 else 0.0
                data.qpos[model.jnt_qposadr[follower]] = np.polyval(model.eq_data[index][4::-1], value)
    mujoco.mj_kinematics(model, data)


def _list_corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    """(n, 3) corners of a mesh, or of the box around another solid, in the world [m]."""
    mesh = int(model.geom_dataid[geom])
    if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_MESH):
        start = int(model.mesh_vertadr[mesh])
        corners = model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])].astype(float)
    else:
        center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        corners = center + half * np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    return data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T  # type: ignore[no-any-return]
