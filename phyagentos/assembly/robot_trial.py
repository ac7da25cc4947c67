"""A robot tried alone in simulation: where its grasps reach, how well it follows, returns and holds."""

import io
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.models.hand import measure_hand
from phyagentos.runtime.motion.draft_settling import build_floor, find_level, measure_reach
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.requests import (
    Approaches,
    Array,
    FindGrasps,
    Motion,
    MotionAnswer,
    NoPlan,
    PlanMove,
    TimeLine,
    Trajectory,
    World,
)

CELLS = 10  # of the map, from the base to the end of the reach
FRONT_RAD = np.radians(40.0)  # to either side of the x axis, for the band of distances
HOLD_S, RETURNS, REST_S = 5.0, 5, 1.0
DRAWS = 5 * RETURNS  # of postures, of which some are not free
LAG_MAX_RAD, RETURN_MAX_M, SLIP_MAX_M = 0.05, 0.001, 0.003
TOOL = "`tool` (see paos robot render), `mount_position_m`, the height of its base"
REASONS, WORDS = 3, {"ik": "out of reach", "line": "no straight line down"}  # shown, and what planning calls them
HEIGHTS_M, AHEAD = (0.25, 0.5, 0.75, 1.0), (0.4, 0.6, 0.8)  # over its base, and in shares of its reach
CUBE, SHARE, LARGEST_M = "cube", 0.6, 0.04  # what is grasped: this share of the opening, at most so wide
MASS_KG = 0.1  # as of the cubes in shipped scenes
FAR_M = 2.5  # where it stands for a robot that takes nothing
Cells = Mapping[tuple[float, float], bool]


@dataclass(frozen=True, slots=True)
class Finding:
    """One measurement; `is_well` where nothing of it would fail a session; `change` is what of a profile decides it."""

    what: str
    measured: str
    is_well: bool = True
    change: str = ""


@dataclass(frozen=True, slots=True)
class Trial:
    """All that was measured; `band_m` is between which distances objects can be taken in front, None without any."""

    findings: tuple[Finding, ...]
    band_m: tuple[float, float] | None
    picture: bytes


def run_trial(profile: TargetProfile, folder: Path) -> Trial:
    """Try a robot; raises DefinitionError of its profile or model."""
    planner = MotionPlanner(profile, folder)
    half_m = min(SHARE * profile.gripper.max_width_m, LARGEST_M) / 2
    cells, refused = _map_grasps(planner, half_m) if half_m else ({}, Counter())
    band_m = find_band(cells)
    findings = []
    if half_m:
        share = sum(cells.values()) / len(cells)
        least_m = float(measure_hand(profile, folder).widths_m[0])
        nowhere = f"nowhere in front ({show_reasons(refused)})"
        shown = f"{band_m[0]:.2f} to {band_m[1]:.2f} m in front" if band_m else nowhere
        findings += [
            Finding(
                "grasps of a cube on the level of the base",
                f"{shown}, {share:.0%} of the map",
                band_m is not None,
                "" if band_m else _advise_height(planner, half_m),
            ),
            Finding(
                "opening",
                f"{least_m * 1e3:.0f} to {profile.gripper.max_width_m * 1e3:.0f} mm, as its pads open in the model",
                least_m < 2.0 * half_m,
                "`gripper.force_n`, with which its drive closes; `travel`, `pad_boxes`",
            ),
        ]
    middle_m = float(np.mean(band_m)) if band_m else FAR_M
    reached = [at for at, found in cells.items() if found]
    place = min(reached, key=lambda at: abs(at[0] - middle_m) + abs(at[1]), default=(FAR_M, FAR_M))
    scene, bodies = _build_scene(half_m or LARGEST_M, (*place, find_level(planner.robot)))
    physics = Physics.alone(profile, folder, scene, seed=0)
    physics.start(0.3)
    findings += _try_returns(planner, physics, World(bodies))
    findings += _try_hold(planner, physics, half_m, bodies) if band_m else ()
    return Trial(tuple(findings), band_m, _draw(cells, band_m))


def _map_grasps(planner: MotionPlanner, half_m: float) -> tuple[Cells, Counter[str]]:
    """Whether a cube of `half_m` can be taken at places (x, y) [m] around the base, from home; and what refused it."""
    reach_m, (x0, y0, _) = measure_reach(planner.robot), planner.robot.profile.mount_position_m
    line = np.round(np.linspace(-reach_m, reach_m, 2 * CELLS + 1), 3).tolist()
    places = [(x + x0, y + y0) for x in line for y in line if 0.1 * reach_m < np.hypot(x, y) <= reach_m]
    answers = {at: _find_grasps(planner, _list_bodies(half_m, (*at, find_level(planner.robot)))) for at in places}
    refused = Counter[str]()
    for answer in answers.values():
        refused.update(answer.rejected if isinstance(answer, NoPlan) else {})
    return {at: isinstance(answer, Approaches) for at, answer in answers.items()}, refused


def _find_grasps(planner: MotionPlanner, bodies: tuple[Entity, ...]) -> MotionAnswer:
    return planner.answer(FindGrasps(world=World(bodies), object=CUBE, q_rad=planner.robot.home_rad, seed=0, count=1))


def _advise_height(planner: MotionPlanner, half_m: float) -> str:
    """What to change where no cube on the level of the base is taken: how it stands, if it takes one that is higher."""
    (x, y, _), reach_m = planner.robot.profile.mount_position_m, measure_reach(planner.robot)
    for up_m in HEIGHTS_M:
        places = [(x + share * reach_m, y, find_level(planner.robot) + up_m) for share in AHEAD]
        if any(isinstance(_find_grasps(planner, _list_bodies(half_m, at)[1:]), Approaches) for at in places):
            return f"`mount_position_m`: it takes one {up_m:g} m over its base, so it stands lower than what it takes"
    return f"{TOOL}, or another hand"


def show_reasons(refused: Mapping[str, int]) -> str:
    """The most frequent reasons for which motions were refused, for people."""
    found = [(reason, Contact.parse(reason)) for reason, _ in Counter(refused).most_common(REASONS)]
    said = [f"{pair.body} touches {pair.other}" if pair else WORDS.get(reason, reason) for reason, pair in found]
    return "; ".join(said)


def find_band(cells: Cells) -> tuple[float, float] | None:
    """The longest span of distances in front of the base at which every place of the map has a grasp [m]."""
    front = sorted(
        (float(np.hypot(*at)), found) for at, found in cells.items() if abs(np.arctan2(at[1], at[0])) < FRONT_RAD
    )
    spans, span = [], list[float]()
    for distance_m, found in [*front, (np.inf, False)]:
        spans += [] if found or len(span) < 2 else [(span[-1] - span[0], span[0], span[-1])]
        span = [*span, distance_m] if found else []
    return max(spans)[1:] if spans else None


def _list_bodies(half_m: float, foot_m: tuple[float, float, float]) -> tuple[Entity, ...]:
    """A wide floor, and a cube that stands on it at `foot_m`."""
    x, y, level_m = foot_m
    cube = Shape(ShapeKind.BOX, (half_m,) * 3)
    return build_floor(level_m), Entity(name=CUBE, kind=CUBE, pose=Pose((x, y, level_m + half_m)), shapes=(cube,))


def _build_scene(half_m: float, foot_m: tuple[float, float, float]) -> tuple[SceneSpec, tuple[Entity, ...]]:
    """The same as a scene, and as planning has it."""
    bodies = _list_bodies(half_m, foot_m)
    written = {
        each.name: {"kind": each.kind, "fixed": not each.movable, "material": "wood", "mass_kg": MASS_KG,
                    "place": {"position_m": each.pose.position_m},
                    "shapes": [{"kind": "box", "size_m": each.shapes[0].size_m}]}
        for each in bodies
    }  # fmt: skip
    materials = {"wood": {"surface": "wood", "rgba": (0.8, 0.7, 0.5, 1.0)}}
    camera = {"position_m": (1.5, 1.5, 1.0), "target_m": (0.0, 0.0, 0.3)}
    scene = {"scene": "trial", "materials": materials, "bodies": written, "cameras": {"c": camera}}
    return SceneSpec.model_validate(scene), bodies


def _follow(physics: Physics, rows: Trajectory, width_m: float) -> float:
    """Carry out a motion; how far a joint lagged behind at most [rad]."""
    lag_rad = 0.0
    for q_rad, qd_rad_s in zip(rows.q_rad, rows.qd_rad_s, strict=True):
        physics.actuation.set_servos(q_rad, qd_rad_s, width_m)
        physics.step()
        lag_rad = max(lag_rad, physics.actuation.find_lag(q_rad))
    physics.step(round(REST_S / rows.step_s))
    return lag_rad


def _move(planner: MotionPlanner, world: World, q_rad: Array, goal_rad: Array) -> MotionAnswer:
    return planner.answer(PlanMove(world=world, q_rad=q_rad, goals_rad=goal_rad[None], seed=0))


def _try_returns(planner: MotionPlanner, physics: Physics, world: World) -> list[Finding]:
    """From home to postures around it and back: how far joints lag, and how far apart the returns are."""
    home, width_m = planner.robot.home_rad, planner.robot.profile.gripper.max_width_m
    low, high = np.maximum(home - 0.5, planner.robot.q_min_rad), np.minimum(home + 0.5, planner.robot.q_max_rad)
    lags, tools, refused = list[float](), list[Array](), Counter[str]()
    for goal in np.random.default_rng(0).uniform(low, high, (DRAWS, len(home))):
        if len(tools) == RETURNS:
            break
        out, back = _move(planner, world, home, goal), _move(planner, world, goal, home)
        if isinstance(out, NoPlan):
            refused.update(out.rejected)
        if isinstance(out, Motion) and isinstance(back, Motion):
            lags += [_follow(physics, each.trajectory, width_m) for each in (out, back)]
            tools.append(np.array(physics.data.site(planner.robot.profile.tcp).xpos))
    if not tools:
        why = f"none was planned ({show_reasons(refused)})"
        return [Finding("motions around home", why, is_well=False, change=f"`home_rad`, `parked_rad`, {TOOL}")]
    spread_m, lag_rad = float(np.linalg.norm(np.ptp(tools, axis=0))), max(lags)
    servos = "`stiffness_nm_rad`, `damping_nms_rad`, `armature_kg_m2`"
    return [
        Finding("joints behind their set-points", f"at most {lag_rad * 1e3:.1f} mrad", lag_rad < LAG_MAX_RAD,
                f"{servos}; `velocity_rad_s`, `acceleration_rad_s2`, `torque_nm`"),
        Finding(f"{len(tools)} returns to home", f"within {spread_m * 1e3:.2f} mm", spread_m < RETURN_MAX_M, servos),
    ]  # fmt: skip


def _try_hold(planner: MotionPlanner, physics: Physics, half_m: float, bodies: tuple[Entity, ...]) -> list[Finding]:
    """Take the cube, lift it, and hold it."""
    what, home, gripper = (
        f"holds a cube of {2e3 * half_m:.0f} mm",
        planner.robot.home_rad,
        planner.robot.profile.gripper,
    )
    change = "`pad_boxes`, `gripper.force_n`, `gripper.palm_depth_m`, `tool` (see paos robot render)"
    found = _find_grasps(planner, bodies)
    line = found.approaches[0].line_rad if isinstance(found, Approaches) else home[None]
    over = _move(planner, World(bodies), home, line[0])
    down, up = planner.answer(TimeLine(line)), planner.answer(TimeLine(line[::-1]))
    if not isinstance(over, Motion) or not isinstance(down, Motion) or not isinstance(up, Motion):
        why = f"no motion to it was planned ({show_reasons(over.rejected if isinstance(over, NoPlan) else {})})"
        return [Finding(what, why, is_well=False, change=f"`home_rad`; {TOOL}")]
    _follow(physics, over.trajectory, gripper.max_width_m)
    _follow(physics, down.trajectory, gripper.max_width_m)
    close_s = gripper.max_width_m / gripper.speed_m_s + gripper.close_time_s
    for width_m in np.linspace(gripper.max_width_m, 0.0, round(close_s / planner.robot.profile.physics_step_s)):
        physics.actuation.set_servos(line[-1], 0.0 * line[-1], float(width_m))
        physics.step()
    _follow(physics, up.trajectory, 0.0)
    tool, cube = physics.data.site(planner.robot.profile.tcp), physics.data.body(CUBE)
    before = np.array(cube.xpos - tool.xpos)
    lifted_m = float(cube.xpos[2] - bodies[1].pose.position_m[2])
    physics.step(round(HOLD_S / planner.robot.profile.physics_step_s))
    slip_m = float(np.linalg.norm(cube.xpos - tool.xpos - before))
    if lifted_m < half_m:
        return [Finding(what, "it was not lifted", is_well=False, change=change)]
    measured = f"lifted {lifted_m * 1e2:.0f} cm, {HOLD_S:g} s, slid {slip_m * 1e3:.1f} mm"
    return [Finding(what, measured, slip_m < SLIP_MAX_M, change)]


def _draw(cells: Cells, band_m: tuple[float, float] | None, size: int = 480) -> bytes:
    """PNG from above, x to the right and y up: green where a grasp was found, red where none was."""
    image = Image.new("RGB", (size, size), "white")
    pen, far_m = ImageDraw.Draw(image), 1.2 * max((abs(each) for at in cells for each in at), default=1.0)
    dot = 0.35 * size / (2 * CELLS + 1)
    for (x, y), found in cells.items():
        u, v = size / 2 * (1 + x / far_m), size / 2 * (1 - y / far_m)
        pen.ellipse((u - dot, v - dot, u + dot, v + dot), "#2a9d4a" if found else "#d9534f")
    for radius_m in band_m or ():
        r = radius_m / far_m * size / 2
        pen.ellipse((size / 2 - r, size / 2 - r, size / 2 + r, size / 2 + r), outline="#333333")
    pen.text((8, 8), f"grasps from above the level of the base; {2 * far_m:.2f} m across, x to the right", "#333333")
    (out := io.BytesIO()).name = "reach.png"
    image.save(out)
    return out.getvalue()
