"""A gripper of two fingers, or a jaw that turns against what stands still, guessed from the solids of a model.

What is guessed is its drive, its pads, and the frame of the tool.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_quaternion

Array = NDArray[np.float64]
Geoms = NDArray[np.intp]
Placed = tuple[Array, tuple[float, float, float, float]]  # position (3,) [m], quaternion wxyz
HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
TIP_M, PAD_M, PROUD_M = (
    0.03,
    (0.01, 0.004, 0.01),
    0.001,
)  # of a finger that grips; half a pad, and how far it stands out
BESIDE_M = 0.01  # aside of the tip of a jaw is still what it closes on
STRAIGHT_COS = 0.8  # between the axis of the last joint and where a hand points
NEAR_RAD = 2.0  # what is further round the hinge than that is no jaw
TAKEN_M, TURN_RAD = 0.04, 0.45  # what a jaw's pad lies flat against, turned by at most this
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
        tip_m: From the tool centre point to the end of the fingers, as far as they reach while they close.
        still: Where joints of fingers stand that the drive does not move [rad or m].
    """

    joints: tuple[str, ...]
    travel: tuple[float, ...]
    pads: tuple[tuple[str, Placed], ...]
    tool: Placed
    palm_m: float
    tip_m: float
    still: dict[str, float] = field(default_factory=dict)


def draft_hand(model: mujoco.MjModel, last: int, fingers: Sequence[int]) -> HandDraft | None:
    """The gripper at a body, of joints below it; None unless two sides with solids close on each other."""
    tops = {_find_top(model, int(model.jnt_bodyid[joint]), last) for joint in fingers}
    solid, data = (model.geom_contype | model.geom_conaffinity) > 0, mujoco.MjData(model)
    if len(fingers) == 1 and int(model.jnt_type[fingers[0]]) == HINGE:
        return _draft_jaw(model, data, last, fingers[0], solid)
    mujoco.mj_kinematics(model, data)
    found = []
    for top in sorted(tops):
        bodies = [body for body in range(model.nbody) if is_below(model, body, top)]
        held = np.flatnonzero(solid & np.isin(model.geom_bodyid, bodies))
        if len(held):
            clouds = [list_corners(model, data, int(geom)) - data.xpos[last] for geom in held]
            away = np.array([np.linalg.norm(cloud, axis=1).max() for cloud in clouds])
            joints = [joint for joint in fingers if int(model.jnt_bodyid[joint]) in bodies]
            found.append(_Finger(held, joints, int(held[away.argmax()]), float(away.max())))
    found.sort(key=lambda each: -round(each.away_m, 4))
    if len(tops) in {2, 4}:
        found = found[:2]  # of four, two are the inner bars of linkages
    pairs = [_close(model, data, pair) for pair in itertools.combinations(found, 2)]
    others = [[each for each in found if each not in pair.fingers] for pair in pairs]
    stills = [_rest(model, data, *each) for each in zip(others, pairs, strict=True)]
    free = [each for each in zip(pairs, others, stills, strict=True) if _is_free(model, data, *each)]
    best = max(free, key=lambda each: round(each[0].opens_m, 4), default=None)
    if best is None or best[0].opens_m < PAD_M[1]:
        return None
    return replace(_draft_pair(model, data, last, best[0]), still=best[2])


@dataclass(frozen=True, slots=True, eq=False)
class _Finger:
    """What hangs on a joint at a palm: its solids and joints, that one first, and the solid at its tip, so far away."""

    geoms: Geoms
    joints: list[int]
    tip: int
    away_m: float


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two fingers: at which ends of their ranges they are wide open, and the gap there and closed [m]."""

    fingers: tuple[_Finger, _Finger]
    wide: tuple[int, ...]
    wide_m: float
    narrow_m: float

    @property
    def opens_m(self) -> float:
        return self.wide_m - max(self.narrow_m, 0.0)

    @property
    def drives(self) -> list[int]:
        return [each.joints[0] for each in self.fingers]


def _close(model: mujoco.MjModel, data: mujoco.MjData, pair: tuple[_Finger, _Finger]) -> _Pair:
    def measure(ends: tuple[int, ...]) -> float:
        drives = [each.joints[0] for each in pair]
        _pose(model, data, drives, [float(model.jnt_range[j][end]) for j, end in zip(drives, ends, strict=True)])
        return float(mujoco.mj_geomDistance(model, data, pair[0].tip, pair[1].tip, FAR_M, None))

    wide = max(itertools.product((0, 1), repeat=2), key=measure)
    return _Pair(pair, wide, measure(wide), measure((1 - wide[0], 1 - wide[1])))


def _draft_pair(model: mujoco.MjModel, data: mujoco.MjData, last: int, pair: _Pair) -> HandDraft:
    geoms, drives, wide = [each.geoms for each in pair.fingers], pair.drives, pair.wide
    _pose(model, data, drives, [float(model.jnt_range[j][end]) for j, end in zip(drives, wide, strict=True)])
    wide_m, narrow_m = pair.wide_m, pair.narrow_m
    slides = int(model.jnt_type[drives[0]]) == SLIDE
    shares = [1.0 if slides else (wide_m - narrow_m) / 2 / float(np.ptp(model.jnt_range[joint])) for joint in drives]
    travel = tuple(share * (2 * end - 1) for share, end in zip(shares, wide, strict=True))
    clouds = [_stack(model, data, each) for each in geoms]
    middles = [(cloud.min(axis=0) + cloud.max(axis=0)) / 2 for cloud in clouds]
    closing = (middles[1] - middles[0]) / np.linalg.norm(middles[1] - middles[0])
    approach = (middles[0] + middles[1]) / 2 - data.xpos[last]
    approach -= closing * (approach @ closing)
    return _place_pads(
        model,
        data,
        last,
        drives,
        list(zip(geoms, clouds, strict=True)),
        R=_build_frame(_find_approach(model, data, last, approach / np.linalg.norm(approach)), closing),
        travel=travel,
    )


def _rest(model: mujoco.MjModel, data: mujoco.MjData, others: Sequence[_Finger], pair: _Pair) -> dict[str, float]:
    """Fingers that are not of a pair, away from it; and joints that nothing moves, straight."""
    fingers = [*others, *([] if model.neq else pair.fingers)]  # else they may follow another joint
    loose = [joint for each in fingers for joint in each.joints[1:]]
    still = {joint: float(np.clip(0.0, *sorted(model.jnt_range[joint]))) for joint in loose}
    for other in others:

        def measure(at: float, drive: int = other.joints[0], tip: int = other.tip) -> float:
            _pose(model, data, [drive], [at])
            away = [float(mujoco.mj_geomDistance(model, data, tip, each.tip, FAR_M, None)) for each in pair.fingers]
            return sum(away)

        still[other.joints[0]] = max(map(float, model.jnt_range[other.joints[0]]), key=measure)
    return {model.joint(joint).name: position for joint, position in still.items()}


def _is_free(
    model: mujoco.MjModel, data: mujoco.MjData, pair: _Pair, others: Sequence[_Finger], still: Mapping[str, float]
) -> bool:
    """Whether no other finger stands between two that are wide open, once it is moved aside."""
    wide = {drive: float(model.jnt_range[drive][end]) for drive, end in zip(pair.drives, pair.wide, strict=True)}
    posed = {model.joint(name).id: position for name, position in still.items()} | wide
    _pose(model, data, list(posed), list(posed.values()))

    def measure(geom: int) -> float:
        """How much longer a line from finger to finger is that touches a solid [m]."""
        legs = [float(mujoco.mj_geomDistance(model, data, each.tip, geom, FAR_M, None)) for each in pair.fingers]
        return sum(legs) - pair.wide_m

    return all(measure(int(geom)) > -PAD_M[1] for other in others for geom in other.geoms)


def find_flange(model: mujoco.MjModel, chain: Sequence[int]) -> Placed:
    """Where the last link of an arm carries a hand: at its end along its axis, away from the joint before."""
    joint, data = chain[-1], mujoco.MjData(model)
    last = int(model.jnt_bodyid[joint])
    mujoco.mj_kinematics(model, data)
    held = [body for body in range(model.nbody) if model.body_weldid[body] == model.body_weldid[last]]
    ends = [list_corners(model, data, geom) for geom in range(model.ngeom) if int(model.geom_bodyid[geom]) in held]
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


@dataclass(frozen=True, slots=True)
class _Jaw:
    """A jaw in one pose, seen along its hinge at `anchor` (3,).

    Attributes:
        axis: (3,) of the hinge.
        plane: (3, 2) across it, to the tip first.
        tip: (n, 3) points of its end, from the anchor.
        near: (k, 3) points of solids that stand still near the tip, by geom.
        lever_m: Its length.
    """

    axis: Array
    anchor: Array
    plane: Array
    tip: Array
    near: dict[int, Array]
    lever_m: float

    def measure_angles(self, points: Array) -> Array:
        """(n,) of points about the hinge, from the middle of the tip [rad]."""
        along: Array = points @ self.plane
        return np.arctan2(along[:, 1], along[:, 0])

    @property
    def rest(self) -> Array:
        """(k, 3) all points of what stands still."""
        return np.vstack([np.empty((0, 3)), *self.near.values()])


def _view_jaw(
    model: mujoco.MjModel, data: mujoco.MjData, joint: int, at_rad: float, turning: Geoms, standing: Geoms
) -> _Jaw:
    _pose(model, data, [joint], [at_rad])
    axis, anchor = np.array(data.xaxis[joint]), np.array(data.xanchor[joint])
    clouds = {int(geom): list_corners(model, data, int(geom)) - anchor for geom in (*turning, *standing)}
    jaw = np.vstack([clouds[int(geom)] for geom in turning])
    away_m = np.linalg.norm(np.cross(jaw, axis), axis=1)
    tip = jaw[away_m > away_m.max() - TIP_M]
    x = np.cross(axis, np.cross(tip.mean(axis=0), axis))
    view = _Jaw(axis, anchor, np.column_stack((x, np.cross(axis, x))) / np.linalg.norm(x), tip, {}, float(away_m.max()))
    low_m, high_m = (tip @ axis).min() - BESIDE_M, (tip @ axis).max() + BESIDE_M
    for geom in map(int, standing):
        points = clouds[geom]
        is_near = np.abs(np.linalg.norm(np.cross(points, axis), axis=1) - view.lever_m) < TIP_M
        is_near &= (low_m < points @ axis) & (points @ axis < high_m) & (np.abs(view.measure_angles(points)) < NEAR_RAD)
        if is_near.any():
            view.near[geom] = points[is_near]
    return view


def _draft_jaw(
    model: mujoco.MjModel, data: mujoco.MjData, last: int, joint: int, solid: NDArray[np.bool_]
) -> HandDraft | None:
    """A jaw that turns against the solids of `last`: they meet where its tip comes nearest to them."""
    moved = [body for body in range(model.nbody) if is_below(model, body, int(model.jnt_bodyid[joint]))]
    turning = np.flatnonzero(solid & np.isin(model.geom_bodyid, moved))
    standing = np.flatnonzero(solid & (model.body_weldid[model.geom_bodyid] == model.body_weldid[last]))
    if not len(turning):
        return None
    low, high = map(float, model.jnt_range[joint])
    view = _view_jaw(model, data, joint, start_rad := min(max(0.0, low), high), turning, standing)
    if not view.near:
        return None
    way = -float(np.sign(view.measure_angles(view.rest).mean()))  # in which it opens
    over = (way * view.measure_angles(view.rest)).max() - (way * view.measure_angles(view.tip)).min()
    view = _view_jaw(model, data, joint, float(np.clip(start_rad + way * over, low, high)), turning, standing)
    face_rad = way * (way * view.measure_angles(view.rest)).max()
    approach = _find_approach(model, data, last, view.plane @ (np.cos(face_rad), np.sin(face_rad)))
    R = _build_frame(approach, way * np.cross(view.axis, approach))
    palm = float(view.anchor @ R[:, 2] + view.lever_m / 2)
    at_rad = float(np.clip(start_rad + way * (over + min(TAKEN_M / view.lever_m, TURN_RAD)), low, high))
    view = _view_jaw(model, data, joint, at_rad, turning, standing)
    sides = [(np.array(list(view.near)), view.anchor + view.rest), (turning, view.anchor + view.tip)]
    return _place_pads(model, data, last, [joint], sides, R, (way * view.lever_m,), palm)


def _find_approach(model: mujoco.MjModel, data: mujoco.MjData, last: int, guess: Array) -> Array:
    """The axis of the last joint (3,) if that is near to where a hand seems to point: few arms reach without that."""
    joint = int(model.body_jntadr[last]) + int(model.body_jntnum[last]) - 1
    axis: Array = data.xaxis[joint] * np.sign(data.xaxis[joint] @ guess)
    return axis if axis @ guess > STRAIGHT_COS else guess


def _place_pads(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    last: int,
    drives: Sequence[int],
    sides: Sequence[tuple[Geoms, Array]],
    R: Array,
    travel: tuple[float, ...],
    palm: float | None = None,
) -> HandDraft:
    """Pads at the inner sides of the tips, in the pose of `data`.

    Args:
        model: Of the arm.
        data: Its pose.
        last: Body that carries the tool.
        drives: Joints.
        sides: Solids of each side, and points (n, 3) of its end.
        R: Orientation of the tool; the second side is on the side of y.
        travel: As of `HandDraft`.
        palm: Where the palm is along z; by default where the solids of `last` end.
    """
    approach, (depth, end, faces, across) = R[:, 2], _find_tips(model, data, sides, R)
    pads = []
    for (geoms, _), face, side in zip(sides, faces, (1.0, -1.0), strict=True):
        body = int(max(model.geom_bodyid[geoms]))  # the farthest one out
        place = R @ np.array((across, face - side * (PAD_M[1] - PROUD_M), depth))
        pads.append((model.body(body).name, _express(data, body, place, R)))
    tool = R @ np.array((across, float(np.mean(faces)), depth))
    held = [
        geom for geom in range(model.ngeom) if model.body_weldid[model.geom_bodyid[geom]] == model.body_weldid[last]
    ]
    if palm is None:
        palm = max((float((list_corners(model, data, geom) @ approach).max()) for geom in held), default=depth - TIP_M)
    return HandDraft(
        joints=tuple(model.joint(joint).name for joint in drives),
        travel=travel,
        pads=tuple(pads),
        tool=_express(data, last, tool, R),
        palm_m=depth - palm,
        tip_m=end - depth,
    )


def _find_tips(
    model: mujoco.MjModel, data: mujoco.MjData, sides: Sequence[tuple[Geoms, Array]], R: Array
) -> tuple[float, float, list[float], float]:
    """Of pads along z and the end of the farther tip; where the inner sides are along y; and the middle along x [m]."""
    ends, tips = [float((cloud @ R[:, 2]).max()) for _, cloud in sides], []
    depth = min(ends) - PAD_M[2] - 0.002
    for geoms, _ in sides:
        solids = [list_corners(model, data, int(geom)) for geom in geoms]
        tips.append(np.vstack([_cut(corners, R[:, 2], depth - PAD_M[2]) for corners in solids]) @ R)
    across = float(np.mean([tip[:, 0].min() + tip[:, 0].max() for tip in tips])) / 2
    return depth, max(ends), [float(tips[0][:, 1].max()), float(tips[1][:, 1].min())], across


def _cut(corners: Array, along: Array, least: float) -> Array:
    """(n, 3) what of the corners of a convex solid is beyond `least` along an axis, and where its edges cross that."""
    beyond = corners @ along >= least
    inside, outside = corners[beyond], corners[~beyond]
    share = (least - outside @ along)[:, None] / ((inside @ along)[None] - (outside @ along)[:, None])
    crossing = outside[:, None] + share[..., None] * (inside[None] - outside[:, None])
    return np.vstack((inside, crossing.reshape(-1, 3)))


def _build_frame(approach: Array, closing: Array) -> Array:
    """(3, 3) of a tool: z as it approaches (3,), y as near to its closing axis (3,) as that allows."""
    y = closing - approach * (closing @ approach)
    y /= np.linalg.norm(y)
    return np.column_stack((np.cross(y, approach), y, approach))


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


def is_below(model: mujoco.MjModel, body: int, top: int) -> bool:
    """Whether a body is another one, or hangs on it."""
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


def _stack(model: mujoco.MjModel, data: mujoco.MjData, geoms: Geoms) -> Array:
    """(n, 3) corners of solids in the world [m]."""
    return np.vstack([list_corners(model, data, int(geom)) for geom in geoms])


def list_corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    """(n, 3) corners of the hull of a mesh, or of the box around another solid, in the world [m]."""
    mesh = int(model.geom_dataid[geom])
    if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_MESH):
        start, graph = int(model.mesh_vertadr[mesh]), int(model.mesh_graphadr[mesh])
        corners = model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])].astype(float)
        if graph >= 0:  # of its hull
            count = int(model.mesh_graph[graph])
            corners = corners[model.mesh_graph[graph + 2 + count : graph + 2 + 2 * count]]
    else:
        center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        corners = center + half * np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    return data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T  # type: ignore[no-any-return]
