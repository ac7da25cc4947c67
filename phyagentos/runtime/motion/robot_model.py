"""The robot as planning sees it: collision solids only, the arm's joints its only freedom, each finger at an opening.

It is compiled apart from the simulated robot: two MuJoCo calls on it cost half of those on the full model.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError, format_names
from phyagentos.geometry import compute_quaternion, compute_rotation
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.allowed_collisions import exclude_pairs, sample_collision_matrix
from phyagentos.runtime.models.base import find_gear
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.hand import measure_hand
from phyagentos.runtime.models.robot import compile_robot, read_base, read_robot
from phyagentos.runtime.models.sources import find_model, find_models
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.tool_bounds import ANYWHERE, ToolBounds

ROBOT_BIT, WORLD_BIT = 1, 2
JOINT_END_RAD = 0.012  # a corner that is smoothed swings out; the guard refuses what is 0.01 from the end of a joint


@dataclass(frozen=True, slots=True)
class Track:
    """The places of a finger in the hand over the opening, piece by piece; each ends at `widths_m` (k,), ascending.

    It is at `positions_m` (k, 3) there, and goes `ways` (k, 3) for a metre of opening; `turns` (k + 1, 4) are
    quaternions wxyz at the ends of all pieces.
    """

    widths_m: Array
    positions_m: Array
    ways: Array
    turns: Array

    def place(self, width_m: float) -> tuple[Array, Array]:
        """Position (3,) and quaternion wxyz (4,) at an opening [m]."""
        if len(self.widths_m) == 1:
            return self.positions_m[0] + self.ways[0] * (width_m - self.widths_m[0]), self.turns[0]
        piece = min(int(np.searchsorted(self.widths_m, width_m)), len(self.widths_m) - 1)
        position = self.positions_m[piece] + self.ways[piece] * (width_m - self.widths_m[piece])
        narrow_m = self.widths_m[piece - 1] if piece else 0.0
        share = np.clip((width_m - narrow_m) / (self.widths_m[piece] - narrow_m), 0.0, 1.0)
        turned = (1.0 - share) * self.turns[piece] + share * self.turns[piece + 1]
        return position, turned / np.linalg.norm(turned)


@dataclass(frozen=True, slots=True)
class RobotModel:
    """One robot for planning scenes, its arm with a frozen hand and collision bits; copy `spec` before adding to it.

    Attributes:
        q_min_rad: (n_joints,) lower joint limits; `q_max_rad` likewise.
        mounting: The base and the first moving link, which stand on the mounting; wheels or legs of a base that moves.
        fingers: Bodies that the gripper moves, open in `spec`.
        jaws: Bodies that touch what is held: the fingers, and what carries a pad and stands still.
        hand: Bodies that move as one with the tool centre point.
        tool: Body that carries the tool centre point, which may be within `bounds`.
    """

    profile: TargetProfile
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    q_min_rad: Array
    q_max_rad: Array
    bodies: frozenset[str]
    mounting: frozenset[str]
    fingers: Mapping[str, Track]
    jaws: frozenset[str]
    hand: frozenset[str]
    tool: str
    bounds: ToolBounds

    @property
    def home_rad(self) -> Array:
        """(n_joints,) the profile's home posture."""
        return np.array(self.profile.arm.home_rad)

    def exceeds_limits(self, q_rad: Array) -> bool:
        """Whether a motion (n, n_joints) comes nearer to the end of a joint than the guard permits, or it began."""
        low = np.minimum(self.q_min_rad + JOINT_END_RAD, q_rad[0])
        high = np.maximum(self.q_max_rad - JOINT_END_RAD, q_rad[0])
        return bool(np.any(q_rad < low) or np.any(q_rad > high))


def measure_fingers(robot: RobotModel) -> Array:
    """(2,) half extents of the closed fingers along the tool's x axis and its closing axis [m]."""
    high_m = np.max([np.abs(bounds).max(axis=0) for bounds in iter_finger_bounds(robot)], axis=0)
    return np.array((high_m[0], high_m[1] - 0.5 * robot.profile.gripper.max_width_m))


def measure_tips(robot: RobotModel) -> float:
    """How far the fingertips are beyond the tool centre point, along the approach [m]."""
    return float(max(bounds[1, 2] for bounds in iter_finger_bounds(robot)))


def iter_finger_bounds(robot: RobotModel) -> Iterator[Array]:
    """(2, 3) least and greatest coordinates of each solid of the open fingers, in the frame of the tool [m]."""
    model, data = robot.model, mujoco.MjData(robot.model)
    mujoco.mj_kinematics(model, data)
    site = model.site(robot.profile.tcp).id
    R = data.site_xmat[site].reshape(3, 3)
    for geom in range(model.ngeom):
        if model.body(int(model.geom_bodyid[geom])).name in robot.fingers:
            G = R.T @ data.geom_xmat[geom].reshape(3, 3)
            center = R.T @ (data.geom_xpos[geom] - data.site_xpos[site]) + G @ model.geom_aabb[geom, :3]
            half = np.abs(G) @ model.geom_aabb[geom, 3:]
            yield np.array((center - half, center + half))


def build_robot_model(profile: TargetProfile, folder: Path, bounds: ToolBounds = ANYWHERE) -> RobotModel:
    """Read the profile's MJCF in `folder` and strip it to what planning needs.

    Raises:
        DefinitionError: When the model cannot be read, lacks a name, or its joints are no serial chain of hinges.
    """
    path = find_model(profile.model, folder)
    spec = read_robot(profile, folder)
    _check_types(spec, profile, path)
    jaws = frozenset(spec.geom(name).parent.name for name in profile.gripper.pads)
    turning = _track_fingers(profile, folder) if profile.gripper.travel else {}
    _strip(spec)
    fingers = _replace_fingers(spec, profile, turning) if turning else _freeze_fingers(spec, profile)
    for geom in spec.geoms:
        geom.contype, geom.conaffinity, geom.condim = ROBOT_BIT, ROBOT_BIT | WORLD_BIT, 1
    model = compile_model(spec, *find_models(profile, folder))
    joints = [model.joint(name) for name in profile.arm.joints]
    if [int(joint.qposadr[0]) for joint in joints] != list(range(model.nq)):
        raise DefinitionError.of(
            "MODEL_INVALID",
            str(path),
            found=f"joints {format_names(joint.name for joint in spec.joints)}",
            expected="the arm's joints in chain order, the gripper's joints, and no others",
        )
    limits = np.array([joint.range for joint in joints])
    exclude_pairs(spec, sample_collision_matrix(model, mujoco.MjData(model), list(range(model.nq))).idle)
    tool = int(model.site_bodyid[model.site(profile.tcp).id])
    first_link = model.body(int(joints[0].bodyid[0])).name
    return RobotModel(
        profile=profile,
        spec=spec,
        model=spec.compile(),
        q_min_rad=limits[:, 0],
        q_max_rad=limits[:, 1],
        bodies=frozenset(body.name for body in spec.bodies[1:]),
        mounting=frozenset({first_link, *(body.name for body in spec.worldbody.bodies)})
        if profile.base is None
        else find_gear(read_base(profile, path), profile.base),
        fingers=fingers,
        jaws=jaws | fingers.keys(),
        hand=frozenset(
            model.body(body).name
            for body in range(1, model.nbody)
            if model.body_weldid[body] == model.body_weldid[tool]
        ),
        tool=model.body(tool).name,
        bounds=bounds,
    )


def _check_types(spec: mujoco.MjSpec, profile: TargetProfile, path: Path) -> None:
    hinge, slide = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    types = dict.fromkeys(profile.arm.joints[profile.servoed], hinge)
    types |= {} if profile.gripper.travel else dict.fromkeys(profile.gripper.joints, slide)
    wrong = [name for name, type in types.items() if int(spec.joint(name).type) != type]
    if wrong:
        raise DefinitionError.of(
            "MODEL_INVALID",
            str(path),
            format_names(wrong),
            expected="hinges as joints of the arm, slides as joints of a gripper without `travel`",
        )


def _strip(spec: mujoco.MjSpec) -> None:
    for elements in (spec.actuators, spec.sensors, spec.keys, spec.equalities, spec.tendons):
        for element in list(elements):
            spec.delete(element)
    for geom in list(spec.geoms):
        if (geom.contype == 0 and geom.conaffinity == 0) or geom.parent.name == "world":
            spec.delete(geom)
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9  # a body may have its mass from visuals alone
    spec.discard_visual()  # meshes and materials that no geom uses any more cost 95 % of a compilation


def _freeze_fingers(spec: mujoco.MjSpec, profile: TargetProfile) -> dict[str, Track]:
    """Move each finger that slides to its share of the full opening and delete its joint."""
    tracks, open_m = {}, profile.gripper.max_width_m
    for name in profile.gripper.joints:
        joint = spec.joint(name)
        finger = joint.parent
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        way = compute_rotation(finger.quat) @ axis / len(profile.gripper.joints)
        finger.pos = np.array(finger.pos) + way * open_m
        tracks[finger.name] = Track(np.array([open_m]), np.array([finger.pos]), way[None], np.array([finger.quat]))
        spec.delete(joint)
    return tracks


def _track_fingers(profile: TargetProfile, folder: Path) -> dict[str, Track]:
    """Every solid body that the hand's joints move, in the frame of the tool's body, over the opening."""
    hand, model = measure_hand(profile, folder), compile_robot(profile, folder)
    data, tool = mujoco.MjData(model), int(model.site_bodyid[model.site(profile.tcp).id])
    joints = [model.joint(name) for name in hand.joints]
    moved = {int(joint.bodyid[0]) for joint in joints}
    for body in range(model.nbody):  # parents come first
        moved |= {body} if int(model.body_parentid[body]) in moved else set()
    solid = {int(body) for body in model.geom_bodyid[(model.geom_contype | model.geom_conaffinity) > 0]}
    poses: dict[int, list[Array]] = {body: [] for body in sorted(moved & solid)}
    for posture in hand.postures:
        data.qpos[[int(joint.qposadr[0]) for joint in joints]] = posture
        mujoco.mj_kinematics(model, data)
        R = data.xmat[tool].reshape(3, 3)
        for body, rows in poses.items():
            turn = compute_quaternion(R.T @ data.xmat[body].reshape(3, 3))
            rows.append(np.concatenate((R.T @ (data.xpos[body] - data.xpos[tool]), turn)))
    widths_m, tracks = hand.widths_m, {}
    for body, rows in poses.items():
        places = np.array(rows)
        same = np.cumprod(np.sign(np.r_[1.0, (places[1:, 3:] * places[:-1, 3:]).sum(axis=1)]))  # q and -q are one turn
        tracks[model.body(body).name] = Track(
            widths_m[1:],
            places[1:, :3],
            ways=np.diff(places[:, :3], axis=0) / np.diff(widths_m)[:, None],
            turns=places[:, 3:] * same[:, None],
        )
    return tracks


def _replace_fingers(spec: mujoco.MjSpec, profile: TargetProfile, tracks: dict[str, Track]) -> dict[str, Track]:
    """Put what a hand moves, body by body, as it stands wide open, on the body of the tool."""
    tool, copied = spec.site(profile.tcp).parent, {}
    for name in tracks:
        same = ("type", "size", "pos", "quat", "meshname", "name")
        copied[name] = [{key: getattr(geom, key) for key in same} for geom in spec.body(name).geoms]
    for joint in [joint for joint in spec.joints if joint.name not in profile.arm.joints]:
        if spec.joint(joint.name) is not None and spec.body(joint.parent.name) is not None:
            spec.delete(joint.parent)
    for name, track in tracks.items():
        position, turned = track.place(profile.gripper.max_width_m)
        body = tool.add_body(name=name, pos=position, quat=turned)
        for geom in copied[name]:
            body.add_geom(**geom, mass=0.001)
    return tracks
