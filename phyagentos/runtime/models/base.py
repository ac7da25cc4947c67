"""A body that drives or walks, in two forms of one model.

As planning sees it, it slides and turns on the ground by the joints `base_x`, `base_y`, `base_yaw`, and its wheels or
legs are rigid. As physics sees it, nothing holds it but its wheels or legs, which motors move.
"""

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError, Problem
from phyagentos.geometry import compute_rotation, multiply
from phyagentos.protocol.capabilities.targets import BASE_JOINTS, HAND, Base, OmniWheels, TargetProfile

FREE_JOINT = "base"
SOLE = "sole/"  # begins the names of the spheres that legs stand on, in the free form of the model
GROUND = "floor"  # kind of the fixed objects that a base stands on
_SCENE_BIT, _ROBOT_BIT = 1, 2
_OVERLAP = 1.05  # of neighbouring rollers, so that the rim is nearly round
_RUBBER = (0.15, 0.15, 0.15, 1.0)
_GRIP = (0.55, 0.005, 0.0001)  # of rubber on anything (`protocol.world.friction`); it decides, whatever the floor is
_ROLLER = {"mass": 0.005, "condim": 3, "contype": 0, "conaffinity": _SCENE_BIT, "rgba": _RUBBER}
_ROLLER |= {"priority": 1, "friction": _GRIP}
_RUN = {"damping": 1e-6, "armature": 1e-6}  # of a roller on its axle


def free_base(spec: mujoco.MjSpec, profile: TargetProfile, base: Base, path: Path) -> None:
    """Let the base stand on its own at home, its joints driven by motors.

    Raises:
        DefinitionError: As of `put_on_plane`.
    """
    body = _prepare(spec, profile, base, path, kept=base.joints)
    x, y, yaw = profile.arm.home_rad[:3]
    body.pos = (x, y, profile.mount_position_m[2])
    body.quat = multiply((float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))), tuple(body.quat))
    body.add_freejoint(name=FREE_JOINT)
    for index, name in enumerate(base.joints):
        motor = spec.add_actuator(name=f"act_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        kp, kv = base.stiffness_nm_rad[index], base.damping_nms_rad[index]
        if kp:
            motor.set_to_position(kp=kp, kv=kv)
        elif kv:
            motor.set_to_velocity(kv=kv)
        else:
            motor.set_to_motor()
        motor.forcelimited, motor.forcerange = True, (-base.torque_nm[index], base.torque_nm[index])
    for index, sole in enumerate(_iter_soles(spec, base)):
        sole.name = f"{SOLE}{index}"
    if base.wheels is not None:
        for geom in spec.geoms:
            if geom.contype or geom.conaffinity:  # rollers meet the scene alone
                geom.contype, geom.conaffinity = _ROBOT_BIT, _SCENE_BIT | _ROBOT_BIT
        for name in base.joints:
            _add_rollers(spec.joint(name), base.wheels)


def put_on_plane(spec: mujoco.MjSpec, profile: TargetProfile, base: Base, path: Path) -> None:
    """Let the base slide and turn on the ground, its wheels or legs rigid.

    Raises:
        DefinitionError: `UNKNOWN_NAME` for a body that the model lacks, or that is held by another.
    """
    body = _prepare(spec, profile, base, path, kept=())
    R = compute_rotation(body.quat)
    for index, name in enumerate(BASE_JOINTS):
        turns = index == 2
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=R[2 if turns else index],
            range=(base.pose_min[index], base.pose_max[index]),
            limited=True,
        )


def find_gear(spec: mujoco.MjSpec, base: Base) -> frozenset[str]:
    """Bodies of wheels or legs, which touch the ground, in a model whose joints are all there."""
    waiting, found = [spec.joint(name).parent for name in base.joints], set()
    while waiting:
        body = waiting.pop()
        found.add(body.name)
        waiting += list(body.bodies)
    return frozenset(found)


def _iter_soles(spec: mujoco.MjSpec, base: Base) -> Iterator["mujoco.MjsGeom"]:
    for geom in (geom for name in base.joints for geom in spec.joint(name).parent.geoms):
        if base.sole_surface is not None and geom.type == mujoco.mjtGeom.mjGEOM_SPHERE and geom.contype:
            yield geom


def _prepare(
    spec: mujoco.MjSpec, profile: TargetProfile, base: Base, path: Path, kept: tuple[str, ...]
) -> "mujoco.MjsBody":
    """The base's body, without joints but those of arm and gripper and the kept ones, which stand as at rest."""
    tops = [each.name for each in spec.worldbody.bodies]
    if base.body not in tops:
        raise DefinitionError([Problem.unknown("body", str(path), base.body, tops)])
    known = [joint.name for joint in spec.joints]
    posture = dict(base.posture_rad)
    unknown = [name for name in (*base.joints, *posture) if name not in known]
    if unknown:
        raise DefinitionError([Problem.unknown("joint", str(path), name, known) for name in unknown])
    if base.wheels is not None:
        replaced = [geom for geom in spec.geoms if geom.parent.name in base.wheels.links]
        meshes = [mesh for mesh in spec.meshes if mesh.name in {geom.meshname for geom in replaced}]
        for element in [*replaced, *meshes]:
            spec.delete(element)
        for name in () if kept else base.joints:
            _add_rim(spec.joint(name), base.wheels)
    driven = {*profile.arm.joints, *profile.gripper.joints, *kept}
    for joint in list(spec.joints):
        if joint.name not in driven and not joint.name.startswith(HAND):  # those of a mounted hand stay
            freeze(joint, posture.get(joint.name, 0.0))
            spec.delete(joint)
    for coupling in [*spec.tendons, *spec.equalities]:
        if not coupling.name.startswith(HAND):
            spec.delete(coupling)
    body = spec.body(base.body)
    if base.mass_kg is not None:
        for geom in body.geoms:
            geom.mass = base.mass_kg / len(body.geoms)
    return body


def freeze(joint: "mujoco.MjsJoint", position: float) -> None:
    """Let a joint's body stand as at a position of the joint [rad or m]."""
    if not position:
        return
    body, axis = joint.parent, np.array(joint.axis) / np.linalg.norm(joint.axis)
    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        body.pos = np.array(body.pos) + compute_rotation(body.quat) @ (position * axis)
    elif joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        turned = (float(np.cos(position / 2)), *(float(np.sin(position / 2)) * axis).tolist())
        anchor = np.array(joint.pos)
        moved = anchor - compute_rotation(turned) @ anchor
        body.pos = np.array(body.pos) + compute_rotation(body.quat) @ moved
        body.quat = multiply(tuple(body.quat), turned)


def _find_axle(joint: "mujoco.MjsJoint", wheels: OmniWheels) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middle of a wheel (3,) [m] and (3, 3) axes of which the first is its axle, in the frame of its body."""
    axle = np.array(joint.axis) / np.linalg.norm(joint.axis)
    side = np.cross(axle, np.eye(3)[int(np.argmin(np.abs(axle)))])
    side /= np.linalg.norm(side)
    return np.array(joint.pos) + wheels.offset_m * axle, np.array((axle, side, np.cross(axle, side)))


def _add_rim(joint: "mujoco.MjsJoint", wheels: OmniWheels) -> None:
    """A wheel as planning sees it: a disc as wide as its rollers."""
    middle, (axle, _, _) = _find_axle(joint, wheels)
    ends = np.concatenate((middle - wheels.roller_radius_m * axle, middle + wheels.roller_radius_m * axle))
    joint.parent.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER, fromto=ends, size=(wheels.radius_m, 0.0, 0.0), mass=0.01, rgba=_RUBBER
    )


def _add_rollers(joint: "mujoco.MjsJoint", wheels: OmniWheels) -> None:
    """Capsules around a wheel, each free to roll about the rim: they carry, and let the wheel slip sideways."""
    middle, (_, side, up) = _find_axle(joint, wheels)
    rim_m = wheels.radius_m - wheels.roller_radius_m
    half_m = _OVERLAP * np.pi * rim_m / wheels.rollers
    for index in range(wheels.rollers):
        angle = 2.0 * np.pi * index / wheels.rollers
        way = np.cos(angle) * side + np.sin(angle) * up
        along = np.cos(angle) * up - np.sin(angle) * side
        roller = joint.parent.add_body(name=f"{joint.name}/roller{index}", pos=middle + rim_m * way)
        roller.add_joint(name=f"{joint.name}/roller{index}", axis=along, **_RUN)
        roller.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=np.concatenate((-half_m * along, half_m * along)),
            size=(wheels.roller_radius_m, 0.0, 0.0),
            **_ROLLER,
        )
