"""The robot as planning sees it: collision solids only, the arm's joints its only freedom, each finger at an opening.

It is compiled apart from the simulated robot: two MuJoCo calls on it cost half of those on the full model.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError, format_names
from phyagentos.geometry import compute_rotation
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.allowed_collisions import exclude_pairs, sample_collision_matrix
from phyagentos.runtime.models.robot import read_robot
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.tool_bounds import ANYWHERE, ToolBounds

ROBOT_BIT, WORLD_BIT = 1, 2


@dataclass(frozen=True, slots=True)
class RobotModel:
    """One robot for planning scenes.

    Attributes:
        spec: Arm and frozen hand, with collision bits; copy it before adding to it.
        model: `spec` compiled.
        q_min_rad: (n_joints,) lower joint limits; `q_max_rad` likewise.
        mounting: The base and the first moving link, which stand on the mounting.
        fingers: Bodies that the gripper moves, open in `spec` -> way (3,) of each in the hand, for a metre of opening.
        hand: Bodies that move as one with the tool centre point.
        tool: Body that carries the tool centre point.
        bounds: Of where that point may be.
    """

    profile: TargetProfile
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    q_min_rad: Array
    q_max_rad: Array
    bodies: frozenset[str]
    mounting: frozenset[str]
    fingers: Mapping[str, Array]
    hand: frozenset[str]
    tool: str
    bounds: ToolBounds

    @property
    def home_rad(self) -> Array:
        """(n_joints,) the profile's home posture."""
        return np.array(self.profile.arm.home_rad)


def measure_fingers(robot: RobotModel) -> Array:
    """(2,) half extents of the closed fingers along the tool's x axis and its closing axis [m]."""
    high_m = np.max([np.abs(bounds).max(axis=0) for bounds in _iter_finger_bounds(robot)], axis=0)
    return np.array((high_m[0], high_m[1] - 0.5 * robot.profile.gripper.max_width_m))


def measure_tips(robot: RobotModel) -> float:
    """How far the fingertips are beyond the tool centre point, along the approach [m]."""
    return float(max(bounds[1, 2] for bounds in _iter_finger_bounds(robot)))


def _iter_finger_bounds(robot: RobotModel) -> Iterator[Array]:
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
    path = folder / profile.model
    spec = read_robot(profile, folder)
    _check_types(spec, profile, path)
    _strip(spec)
    fingers = _freeze_fingers(spec, profile)
    for geom in spec.geoms:
        geom.contype, geom.conaffinity, geom.condim = ROBOT_BIT, ROBOT_BIT | WORLD_BIT, 1
    model = spec.compile()
    joints = [model.joint(name) for name in profile.arm.joints]
    if [int(joint.qposadr[0]) for joint in joints] != list(range(model.nq)):
        found = f"joints {format_names(joint.name for joint in spec.joints)}"
        expected = "the arm's joints in chain order, the gripper's joints, and no others"
        raise DefinitionError.of("NO_SERIAL_CHAIN", str(path), found, expected)
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
        mounting=frozenset({first_link, *(body.name for body in spec.worldbody.bodies)}),
        fingers=fingers,
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
    types = dict.fromkeys(profile.arm.joints, hinge) | dict.fromkeys(profile.gripper.joints, slide)
    wrong = [name for name, type in types.items() if int(spec.joint(name).type) != type]
    if wrong:
        expected = "hinges as joints of the arm, slides as joints of the gripper"
        raise DefinitionError.of("NO_SERIAL_CHAIN", str(path), format_names(wrong), expected)


def _strip(spec: mujoco.MjSpec) -> None:
    for elements in (spec.actuators, spec.sensors, spec.keys, spec.equalities, spec.tendons):
        for element in list(elements):
            spec.delete(element)
    for geom in list(spec.geoms):
        if (geom.contype == 0 and geom.conaffinity == 0) or geom.parent.name == "world":
            spec.delete(geom)
    spec.discard_visual()  # meshes and materials that no geom uses any more cost 95 % of a compilation


def _freeze_fingers(spec: mujoco.MjSpec, profile: TargetProfile) -> dict[str, Array]:
    """Move each finger to its share of the full opening and delete its joint; the way of each a metre."""
    ways = {}
    for name in profile.gripper.joints:
        joint = spec.joint(name)
        finger = joint.parent
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        ways[finger.name] = compute_rotation(finger.quat) @ axis / len(profile.gripper.joints)
        finger.pos = np.array(finger.pos) + ways[finger.name] * profile.gripper.max_width_m
        spec.delete(joint)
    return ways
