"""A draft of a profile made whole in the model: an opening that its pads have, a home that is free, limits."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from phyagentos.errors import DefinitionError, raise_any
from phyagentos.geometry import compute_inverse, compute_matrix, compute_rotation, convert_euler
from phyagentos.protocol.capabilities.targets import FINGERTIP_CLEAR_M, TargetProfile
from phyagentos.protocol.settings.safety import UNITS
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.drafting import ProfileDraft
from phyagentos.runtime.models.hand import HandMotion, measure_hand
from phyagentos.runtime.models.hand_drafting import PAD_M, PROUD_M, TAKEN_M, HandDraft, list_corners
from phyagentos.runtime.models.robot import build_robot, read_profile
from phyagentos.runtime.models.sources import find_models
from phyagentos.runtime.motion.chain import Chain, build_chain
from phyagentos.runtime.motion.planning_scene import PlanningScenes
from phyagentos.runtime.motion.poses import point_tool_down
from phyagentos.runtime.motion.profile_checks import find_profile_problems
from phyagentos.runtime.motion.requests import Array, World
from phyagentos.runtime.motion.robot_model import RobotModel, build_robot_model

PROBE, DEPTHS_M = "probe", np.arange(0.0, 0.1, 0.001)  # what it may touch above the tool centre point, and where
LEAST_DEPTH_M, DEPTH_CLEAR_M = 0.005, 0.003  # above the tool centre point, and below what else would touch
TAKEN_SHARE, FACING_COS = 0.6, 0.92  # of the opening, for what is taken; what a check demands of pads, and some more
LEAST_M = 0.05  # half of a workspace, where the tool stays on the axis of the only joint
FLOOR_M = (3.0, 3.0, 0.02)  # half sizes of a floor
SAMPLES = 300  # postures of which the arm's reach and its home are found
HOMES = [(x, z) for x in (0.5, 0.4, 0.6, 0.3) for z in (0.3, 0.2, 0.45)]  # of the tool, in shares of the reach
TURNS_RAD = (0.0, np.pi / 2, -np.pi / 2, np.pi)
MOUNTS = [Pose((0.0, 0.0, up_m), convert_euler((0.0, 0.0, turn))) for up_m in (0.0, 0.1, 0.2) for turn in TURNS_RAD]
FRONT = [
    (x, y) for x in (0.3, 0.4, 0.5, 0.6, 0.7, 0.8) for y in (-0.2, 0.0, 0.2)
]  # of its work, in shares of the reach
LEVELS_M = (0.02, 0.12)  # at which it takes objects, and over them
SHEET = "check: the maker's data sheet"


def settle_draft(draft: ProfileDraft, file: Path) -> tuple[ProfileDraft, str]:
    """Write a draft to `robots/<name>/target.yaml` so that nothing of it is refused; and the text of its limits.

    A gripper that does not close in the model as it was guessed is left out.

    Raises:
        DefinitionError: What no change of the draft mends: `IN_COLLISION` where no posture is free.
    """
    if draft.hand is not None:
        try:
            return _settle(draft, file)
        except DefinitionError:
            draft = replace(draft, hand=None)
    return _settle(draft, file)


def _settle(draft: ProfileDraft, file: Path) -> tuple[ProfileDraft, str]:
    profile, folder = _write(draft, file), file.parent
    if draft.hand is not None:
        draft, profile = _open_hand(draft, draft.hand, file)
    robot = build_robot_model(profile, folder)
    reach_m = measure_reach(robot)
    if profile.end_effector == "opening" and (mount := _find_mount(robot, reach_m)) != MOUNTS[0]:
        draft = replace(draft, mount=mount)
        robot = build_robot_model(_write(draft, file), folder)
    home_rad = _find_home(robot, reach_m)
    draft = replace(draft, home_rad=home_rad.tolist(), band_m=(round(0.4 * reach_m, 2), round(0.8 * reach_m, 2)))
    profile = _write(draft, file)
    raise_any(find_profile_problems(file, profile, None))
    return draft, _render_limits(draft, profile, robot, reach_m)


def _write(draft: ProfileDraft, file: Path) -> TargetProfile:
    file.write_text(draft.render(), encoding="utf-8")
    return read_profile(file)[0]


def _open_hand(draft: ProfileDraft, guess: HandDraft, file: Path) -> tuple[ProfileDraft, TargetProfile]:
    """Its widest opening at which the pads face each other, its tool amid that, and how deep it takes what it takes."""
    profile, folder = _write(draft, file), file.parent
    hand, (model, data) = measure_hand(profile, folder), _build_probe(profile, folder)
    turned = [_measure_pads(model, data, profile, hand, width_m) for width_m in hand.widths_m.tolist()]
    width_m = max(hand.widths_m[np.array([cos for cos, _ in turned]) > FACING_COS], default=0.0)
    tip_m = max(
        [guess.tip_m, *(tip_m for (_, tip_m), at_m in zip(turned, hand.widths_m, strict=True) if at_m <= width_m)]
    )
    place, turn = guess.tool
    amid = place + compute_rotation(turn)[:, 1] * hand.find_middle(width_m)
    draft = replace(draft, hand=replace(guess, tool=(amid, turn), tip_m=tip_m), width_m=np.floor(width_m * 1e3) / 1e3)
    profile = _write(draft, file)
    most_m = max(guess.palm_m - FINGERTIP_CLEAR_M, LEAST_DEPTH_M)
    depth_m = min(most_m, _measure_depth(profile, folder, min(TAKEN_M, TAKEN_SHARE * width_m)))
    draft = replace(draft, depth_m=max(depth_m, LEAST_DEPTH_M))
    return draft, _write(draft, file)


def _build_probe(
    profile: TargetProfile, folder: Path, half_m: ArrayLike = PAD_M
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot at home, and a box that can be put anywhere."""
    spec = build_robot(profile, folder)
    spec.worldbody.add_body(name=PROBE, mocap=True).add_geom(name=PROBE, type=mujoco.mjtGeom.mjGEOM_BOX, size=half_m)
    model = compile_model(spec, *find_models(profile, folder))
    data = mujoco.MjData(model)
    for name, position in zip(profile.arm.joints, profile.arm.home_rad, strict=True):
        data.joint(name).qpos = position
    return model, data


def _measure_pads(
    model: mujoco.MjModel, data: mujoco.MjData, profile: TargetProfile, hand: HandMotion, width_m: float
) -> tuple[float, float]:
    """At an opening: cosine between closing axis and the way from pad to pad; how far their fingers reach [m]."""
    for name, position in zip(hand.joints, hand.pose(width_m), strict=True):
        data.joint(name).qpos = position
    mujoco.mj_kinematics(model, data)
    between = np.subtract(*(data.geom(name).xpos for name in profile.gripper.pads))
    tool, fingers = data.site(profile.tcp), [model.geom(name).bodyid[0] for name in profile.gripper.pads]
    _, y, z = tool.xmat.reshape(3, 3).T
    solid = np.flatnonzero((model.geom_contype | model.geom_conaffinity) & np.isin(model.geom_bodyid, fingers))
    tip_m = max(float(((list_corners(model, data, geom) - tool.xpos) @ z).max()) for geom in solid.tolist())
    return abs(float(between @ y)) / float(np.linalg.norm(between)), tip_m


def _measure_depth(profile: TargetProfile, folder: Path, width_m: float) -> float:
    """How far what is so wide may reach above the tool centre point before it touches something else than pads [m]."""
    hand = measure_hand(profile, folder)
    model, data = _build_probe(profile, folder, (PAD_M[0], width_m / 2 - PROUD_M, PROUD_M))
    _measure_pads(model, data, profile, hand, width_m)
    pads = {model.geom(name).id for name in (PROBE, *profile.gripper.pads)}
    solid = [each for each in np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist() if each not in pads]
    tool = data.site(profile.tcp)
    mujoco.mju_mat2Quat(data.mocap_quat[0], tool.xmat)
    for above_m in DEPTHS_M:
        data.mocap_pos[0] = tool.xpos + tool.xmat.reshape(3, 3) @ (0.0, hand.find_middle(width_m), -above_m)
        mujoco.mj_kinematics(model, data)
        if any(mujoco.mj_geomDistance(model, data, each, model.geom(PROBE).id, 1.0, None) < 0.0 for each in solid):
            return float(above_m - DEPTH_CLEAR_M)
    return float(DEPTHS_M[-1])


def _draw_postures(chain: Chain) -> Array:
    """(SAMPLES, n_joints) within the limits of the joints."""
    low, high = np.maximum(chain.q_min_rad, -np.pi), np.minimum(chain.q_max_rad, np.pi)
    low = np.minimum(low, high)  # a joint may have less than the margin
    return np.random.default_rng(0).uniform(low, high, (SAMPLES, len(low)))


def measure_reach(robot: RobotModel) -> float:
    """How far from the base its tool comes [m]."""
    base, chain = np.array(robot.profile.mount_position_m), build_chain(robot)
    return max(float(np.linalg.norm(chain.compute_tcp(q_rad)[:3, 3] - base)) for q_rad in _draw_postures(chain))


def _find_mount(robot: RobotModel, reach_m: float) -> Pose:
    """Where its base stands, and how it is turned, so that its hand points down at most places in front of it."""
    chain = build_chain(robot)
    seeds = _draw_postures(chain)[:20]

    def count(mount: Pose) -> float:
        found, to_base = 0.0, compute_inverse(compute_matrix(mount))
        for x, y in FRONT:
            along_rad, ats = float(np.arctan2(y, x)), [np.array((x * reach_m, y * reach_m, z)) for z in LEVELS_M]
            downs = [[to_base @ point_tool_down(along_rad + turn, at) for at in ats] for turn in TURNS_RAD[:2]]
            found += any(all(len(chain.solve_all(down, seeds, 0.1)[0]) for down in way) for way in downs)
        return found - 10.0 * mount.position_m[2]  # one more place for each 10 cm

    return max(MOUNTS, key=count)


def find_level(robot: RobotModel) -> float:
    """Height at which objects stand [m]: that of the base, or of what its column stands on."""
    return 0.0 if robot.profile.stands_on_column else robot.profile.mount_position_m[2]


def build_floor(level_m: float) -> Entity:
    """A wide floor on which objects stand."""
    pose, shape = Pose((0.0, 0.0, level_m - FLOOR_M[2])), Shape(ShapeKind.BOX, FLOOR_M)
    return Entity(name="floor", kind="floor", pose=pose, movable=False, shapes=(shape,))


def _find_home(robot: RobotModel, reach_m: float) -> Array:
    """A posture (n_joints,) that is free, and above the floor if one is: the tool down in front, if there is one."""
    floors = (build_floor(find_level(robot)),)
    homes = [home_rad for entities in (floors, ()) for home_rad in _find_free(robot, reach_m, World(entities))[:1]]
    return homes[0] if homes else robot.home_rad


def _find_free(robot: RobotModel, reach_m: float, world: World) -> list[Array]:
    """Free postures (n_joints,), the best first."""
    chain, scene = build_chain(robot), PlanningScenes(robot).get_scene(world)
    seeds, middle = _draw_postures(chain), (robot.q_min_rad + robot.q_max_rad) / 2
    pose = np.diag((1.0, -1.0, -1.0, 1.0))
    for x, z in HOMES if robot.profile.end_effector == "opening" else ():
        pose[:3, 3] = x * reach_m, 0.0, z * reach_m
        if free := [q_rad for q_rad in chain.solve_all(pose, seeds[:60], 0.1)[0] if scene.is_free(q_rad)]:
            return sorted(free, key=lambda q_rad: float(np.linalg.norm(q_rad - middle)))
    zero = np.clip(0.0 * middle, robot.q_min_rad, robot.q_max_rad)
    return [q_rad for q_rad in (robot.home_rad, zero, *seeds) if scene.is_free(q_rad)]


def _render_limits(draft: ProfileDraft, profile: TargetProfile, robot: RobotModel, reach_m: float) -> str:
    """The text of safety.yaml: what the model says, and guesses marked `check`."""
    arm, gripper, r = profile.arm, profile.gripper, max(round(reach_m, 2), LEAST_M)
    model, site = f"The model {draft.file}", "Site policy"
    known = all(draft.speeds.get(name) for name in arm.joints)
    values: dict[str, tuple[ArrayLike, str]] = {
        "joint_position_min": (robot.q_min_rad, f"{model}, lower joint limits"),
        "joint_position_max": (robot.q_max_rad, f"{model}, upper joint limits"),
        "joint_velocity_max": (arm.velocity_rad_s, f"{model}, joint speeds" if known else SHEET),
        "joint_acceleration_max": (arm.acceleration_rad_s2, f"{SHEET}; planned so"),
        "joint_jerk_max": (arm.jerk_rad_s3, f"{site}: held against the mean over a control period"),
        "workspace_box": (((-r, -r, -0.02), (r, r, r)), f"{site}, check: how far the tool reaches; world frame"),
        "gripper_width_max": (gripper.max_width_m, f"{model}, as its pads open"),
        "gripper_force_max": (1.5 * gripper.force_n, SHEET),
        "command_rate_max": (1.0 / profile.control_period_s, f"{site}: one command per control period"),
        "command_validity_max": (5.0 * profile.control_period_s, f"{site}: five control periods"),
        "session_duration_max": (600.0, site),
        "collision_depth_max": (0.004, f"{site}: planning keeps 4 mm from what stands fixed"),
        "tracking_error_max": (0.25, f"{site}: below one hand's width at the tool"),
    }
    lines = [f"# What the guard enforces for {profile.target}; a workspace adds it to its safety.yaml.",
             "version: 1", "targets:", f"  {profile.target}:"]  # fmt: skip
    for name, (value, source) in values.items():
        asks = f"   # {source[source.index('check') :]}" if "check" in source and np.any(value) else ""
        policy = "site_policy" if source.startswith(site) else "planner_constrained"
        lines += [
            f"    {name}:{asks}",
            f"      value: {np.round(np.asarray(value, dtype=float), 6).tolist()}",
            f"      unit: {UNITS.get(name, 'm')}",
            f'      source: "{source}"',
            f"      provenance: {policy}",
        ]
    return "\n".join(lines) + "\n"
