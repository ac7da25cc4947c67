"""What is missing in a robot's profile before it can work, each at its line: `paos robot check`."""

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError, Problem
from phyagentos.geometry import convert_euler, multiply
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import Located, read_yaml
from phyagentos.protocol.settings.safety import Safety, TargetLimits, as_numbers
from phyagentos.runtime.models.robot import compile_robot, read_profile
from phyagentos.runtime.motion.planning_scene import PlanningScenes
from phyagentos.runtime.motion.requests import World
from phyagentos.runtime.motion.robot_model import RobotModel, build_robot_model, iter_finger_bounds

_POINTS = {90: "x", 180: "-z", -90: "-x"}  # where fingers point, by the turn about y that mends it
PLANNED = (("joint_velocity_max", "velocity_rad_s"), ("joint_acceleration_max", "acceleration_rad_s2"))
TOLERANCE = 1e-6
ALONG_COS = 0.9  # between the way of the fingers and the closing axis


def find_profile_problems(path: Path, profile: TargetProfile, limits: Safety | None) -> list[Problem]:
    """Problems of a profile that could be read, of its model, and of its limits, where they are given.

    Raises:
        DefinitionError: The model cannot be built at all.
    """
    located = read_yaml(path)
    own = None if limits is None else limits.targets.get(profile.target)
    problems = [] if limits is None or own else [_describe_no_limits(profile, path)]
    problems += _iter_faster(profile, own, located) if own else []
    if not profile.model:
        return problems
    compile_robot(profile, path.parent)  # physics needs masses, planning none
    return [*problems, *find_model_problems(build_robot_model(profile, path.parent), located)]


def find_model_problems(robot: RobotModel, located: Located) -> Iterator[Problem]:
    """Problems of postures and hand in the model, at their lines of the profile."""
    yield from _iter_posture_problems(robot, located)
    yield from _iter_gripper_problems(robot, located)


def _iter_faster(profile: TargetProfile, limits: TargetLimits, located: Located) -> Iterator[Problem]:
    """The first joint whose speed, and whose acceleration, is planned with and refused by the guard."""
    for name, field in PLANNED:
        planned, allowed = np.array(getattr(profile.arm, field)), np.array(as_numbers(getattr(limits, name)))
        if len(allowed) not in {1, len(planned)}:
            continue  # safety.yaml's own problem
        for index in np.flatnonzero(planned > allowed * (1.0 + TOLERANCE)).tolist()[:1]:
            at_most = float(np.broadcast_to(allowed, planned.shape)[index])
            found, expected = f"{planned[index]:g}", f"at most {at_most:g}, which safety.yaml allows as {name}"
            turned = float(np.radians(planned[index]))
            hint = f"For degrees write {turned:.4g}." if turned <= at_most * 1.01 else f"Write {at_most:g} or less."
            yield located.problem("INVALID_VALUE", ("arm", field, index), found, expected, hint)


def _describe_no_limits(profile: TargetProfile, path: Path) -> Problem:
    place = path.with_name("safety.yaml")
    return Problem(
        "MISSING_VALUE",
        str(path),
        f"no limits of {profile.target}",
        f"targets.{profile.target}",
        hint=f"Write {place} with a source for each limit: what has no limits never moves.",
    )


def _iter_posture_problems(robot: RobotModel, located: Located) -> Iterator[Problem]:
    """Of the home posture and the named ones: joints beyond their range, and what touches."""
    names = robot.profile.arm.joints
    scene = PlanningScenes(robot).get_scene(World(entities=()))
    postures = {("arm", "home_rad"): robot.home_rad}
    base = robot.home_rad[: robot.profile.servoed.start]
    named = robot.profile.postures.items()
    postures |= {("postures", name): np.concatenate((base, value)) for name, value in named}
    for address, q_rad in postures.items():
        outside = (q_rad < robot.q_min_rad) | (q_rad > robot.q_max_rad)
        for index in np.flatnonzero(outside).tolist():
            low, high = robot.q_min_rad[index], robot.q_max_rad[index]
            found, expected = f"{names[index]} at {q_rad[index]:g} rad", f"{low:.4g} to {high:.4g}"
            turned = np.radians(q_rad[index])
            hint = f"For degrees write {turned:.4g}." if low <= turned <= high else "Write a number between them."
            yield located.problem("INVALID_VALUE", (*address, index), found, expected, hint)
        for first, second in [] if outside.any() else scene.find_contacts(q_rad):
            yield located.problem("IN_COLLISION", address, f"{first} touches {second}", "a posture that is free")


def _iter_gripper_problems(robot: RobotModel, located: Located) -> Iterator[Problem]:
    """Of a gripper that opens: its pads, and whether they close along the y axis of the tool."""
    gripper, model = robot.profile.gripper, robot.model
    if robot.profile.end_effector != "opening":
        return
    if len(gripper.pads) != 2:
        yield located.problem(
            "INVALID_VALUE", ("gripper", "pads"), f"{len(gripper.pads)} pads", "two that face each other"
        )
        return
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home_rad
    mujoco.mj_kinematics(model, data)
    tool = data.site_xmat[model.site(robot.profile.tcp).id].reshape(3, 3)
    between = np.subtract(*(data.geom_xpos[model.geom(name).id] for name in gripper.pads))
    along = np.abs(tool.T @ between) / np.linalg.norm(between)
    if along[1] < ALONG_COS:
        found = f"pads that face each other at {np.degrees(np.arccos(along[1])):.0f} degrees to y"
        hint = "Turn `tool.quaternion_wxyz` about z, which approaches."
        yield located.problem("MODEL_INVALID", ("tool",), found, "along y, the closing axis", hint)
    elif (turn_deg := _find_turn(robot)) and robot.profile.tool is not None:
        turned = multiply(robot.profile.tool.quaternion_wxyz, convert_euler((0.0, np.radians(turn_deg), 0.0)))
        found = f"fingers that point along {_POINTS[turn_deg]} of the tool"
        hint = f"Write quaternion_wxyz: [{', '.join(f'{round(value, 6) + 0.0:g}' for value in turned)}] there."
        yield located.problem("MODEL_INVALID", ("tool",), found, "along z, which approaches", hint)


def _find_turn(robot: RobotModel) -> int:
    """By how many degrees about y the z axis of the tool is to be turned to point where its fingers do."""
    bounds = np.array(list(iter_finger_bounds(robot)))
    if not len(bounds):
        return 0
    x, _, z = -(bounds[:, 0].min(axis=0) + bounds[:, 1].max(axis=0))  # they reach further back than beyond the tool
    ways = {0: z, 90: x, 180: -z, -90: -x}
    return max(ways, key=lambda turn_deg: ways[turn_deg])


def describe_robot(robot: RobotModel) -> dict[str, str]:
    """What the model says, for people."""
    model, profile = robot.model, robot.profile
    excluded = len(model.exclude_signature)
    return {
        "joints": ", ".join(profile.arm.joints),
        "ranges, rad": ", ".join(f"{a:.2f}..{b:.2f}" for a, b in zip(robot.q_min_rad, robot.q_max_rad, strict=True)),
        "hand": ", ".join(sorted(robot.hand - set(robot.fingers))),
        "fingers": ", ".join(sorted(robot.fingers)) or "none",
        "opening, m": f"0 to {profile.gripper.max_width_m:g}",
        "pairs that cannot touch": f"{excluded} of {len(robot.bodies) * (len(robot.bodies) - 1) // 2}",
    }


def check_profile(path: Path, limits: Safety | None = None) -> list[Problem]:
    """Every problem of a profile, those of reading it included, and of its limits where they are given."""
    try:
        profile, _ = read_profile(path)
        return find_profile_problems(path, profile, limits)
    except DefinitionError as error:
        return list(error.problems)
