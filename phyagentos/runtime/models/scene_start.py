"""How a scene begins: which bodies are sunk into each other, have nothing to stand on, or are seen by no camera.

Authors learn it from lint, which draws a few seeds; preflight asks for the seed of the session, with the robot.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.errors import ExecutionError, Problem
from phyagentos.protocol.capabilities.placed_scenes import place_scene
from phyagentos.protocol.documents.schema import Located, read_yaml
from phyagentos.protocol.settings.sensors import CameraSettings, Sensors
from phyagentos.protocol.world.scenes import SceneSpec, read_scene
from phyagentos.runtime.models.camera_model import find_mounting
from phyagentos.runtime.models.compiling import explain
from phyagentos.runtime.models.scene import add_scene, draw_bodies
from phyagentos.runtime.models.world import Robot, compile_scene, name_prefix

SUNK_M = 0.003  # what physics pushes apart gently; resting bodies are sunk by less
DROP_M = 0.03  # a fall that may be meant, into a tray for instance
LEVEL = 0.9  # cosine between a contact's normal and the vertical: one body lies on the other
SEEDS = (0, 1, 2)
OVERLAP = "overlap"  # kind of a problem: what is sunk is thrown about
_SOLID = np.array([1, 1, 0, 1, 1, 1], dtype=np.uint8)  # groups of geoms that touch; decor is in group 2
ALIKE_RGB = 0.12  # of two colours that noise and shadow make one
BAND_SHARE, IN_VIEW = 1.35, "in view"  # of the farthest that a robot grasps best: its reach, about
_DRAWN = np.ones(6, dtype=np.uint8)


def find_start_problems(path: Path, seed: int | None = None, robot: Robot | None = None) -> list[Problem]:
    """Every problem of how a scene begins, at file:line:column, with the given seed, else with a few of them.

    Raises:
        DefinitionError: The scene cannot be read.
    """
    spec, located = read_scene(path), read_yaml(path)
    spec = place_scene(spec, robot[0].placement) if robot is not None else spec
    for each in SEEDS if seed is None else (seed,):
        try:
            if robot is None:
                add_scene(world := mujoco.MjSpec(), spec, draw_bodies(spec, each))
            model = compile_scene([robot], spec, each).model if robot is not None else world.compile()
        except ExecutionError as error:
            return [located.problem(error.code, ("areas",), str(error).partition(": ")[2])]
        except (ValueError, mujoco.FatalError) as error:
            return [explain(str(error), path)]
        data = mujoco.MjData(model)
        mujoco.mj_fwdPosition(model, data)
        if problems := [*_iter_overlaps(spec, located, model, data), *_iter_unsupported(spec, located, model, data)]:
            return problems
    return []


def _iter_overlaps(spec: SceneSpec, located: Located, model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Problem]:
    """Pairs of bodies of which a movable one is sunk into the other, each once, with the deepest contact."""
    deepest: dict[tuple[str, str], tuple[float, float]] = {}
    for contact in data.contact:
        names = [model.body(model.geom_bodyid[geom]).name for geom in contact.geom]
        own = [name for name in names if name in spec.bodies and not spec.bodies[name].fixed]
        if not own or spec.bodies[own[-1]].joint or spec.bodies[own[-1]].part_of or contact.dist > -SUNK_M:
            continue
        body = own[-1]
        pair = (body, names[0] if names[1] == body else names[1])
        deepest[pair] = max(deepest.get(pair, (0.0, 0.0)), (-contact.dist, abs(contact.frame[2])))
    for (body, other), (depth_m, upright) in deepest.items():
        is_robot = other.partition(".")[0] not in spec.bodies  # a ball of its contents is `cup.1`
        lies = upright > LEVEL and other in spec.bodies and spec.bodies[other].fixed
        yield Problem(
            "SCENE_INVALID",
            located.address_of(("bodies", body, "place")),
            found=f"{body!r}, {depth_m:.3f} m inside of {other!r}" + (", which is the robot's" if is_robot else ""),
            expected="bodies that touch at most",
            hint=f"Raise it by {depth_m:.3f} m." if lies else "Move one of them.",
            kind=OVERLAP,
        )


def _iter_unsupported(
    spec: SceneSpec, located: Located, model: mujoco.MjModel, data: mujoco.MjData
) -> Iterator[Problem]:
    """Movable bodies that would fall: below their middle and the corners of their bounds is nothing near."""
    for name, body in spec.bodies.items():
        if body.fixed or body.joint or body.part_of or all(solid.decor for solid in body.shapes):
            continue
        low_m, high_m = _compute_bounds(model, data, model.body(name).id)
        (x_m, y_m), geom = (low_m + high_m)[:2] / 2.0, np.zeros(1, dtype=np.int32)
        corners = [(x_m, y_m), *product((low_m[0], high_m[0]), (low_m[1], high_m[1]))]
        gaps: list[tuple[float, str]] = []
        for x, y in corners:
            start_m = np.array((x, y, low_m[2] + SUNK_M))
            down = np.array((0.0, 0.0, -1.0))
            gap_m = mujoco.mj_ray(model, data, start_m, down, _SOLID, 1, model.body(name).id, geom) - SUNK_M
            gaps += [(gap_m, model.body(model.geom_bodyid[geom[0]]).name)] if geom[0] >= 0 else []
        gap_m, below = min(gaps, default=(np.inf, ""))
        if gap_m > DROP_M:
            yield located.problem(
                "SCENE_INVALID",
                ("bodies", name, "place"),
                found=f"{name!r}, {f'{gap_m:.3f} m above {below!r}' if gaps else 'with nothing below it'}",
                expected="something to stand on",
                hint=f"Lower it by {gap_m:.3f} m, or move it to where something bears it." if gaps else "Move it.",
            )


def _compute_bounds(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest coordinates (3,) of what of a body touches, in the world [m]."""
    geoms = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == body and model.geom_contype[geom]]
    turns = [np.abs(data.geom_xmat[geom].reshape(3, 3)) for geom in geoms]
    halves = np.array([turn @ model.geom_aabb[geom][3:] for geom, turn in zip(geoms, turns, strict=True)])
    return (data.geom_xpos[geoms] - halves).min(axis=0), (data.geom_xpos[geoms] + halves).max(axis=0)


def pose_start(model: mujoco.MjModel, robots: Sequence[Robot]) -> mujoco.MjData:
    """The state with which a model of a scene begins, its robots at home."""
    data = mujoco.MjData(model)
    for profile, _ in robots:
        prefix, servoed = name_prefix(profile.target, len(robots)), profile.servoed  # a base stands at home
        for joint, angle_rad in zip(profile.arm.joints[servoed], profile.arm.home_rad[servoed], strict=True):
            data.joint(prefix + joint).qpos = angle_rad
    mujoco.mj_forward(model, data)
    return data


def explain_unseen(spec: SceneSpec, name: str, seed: int, robot: Robot, sensors: Sensors) -> str:
    """Where a body of the scene starts, and for each camera, with the robot at home, what keeps it from seeing it."""
    model = compile_scene([robot], spec, seed).model
    data = pose_start(model, [robot])
    reasons: dict[str, list[str]] = {}
    for camera, sensor in sensors.cameras.items():
        if sensor.camera is not None:
            reasons.setdefault(_find_reason(model, data, name, sensor.camera), []).append(camera)
    x, y, z = data.body(name).xpos
    told = "; ".join(f"{reason} ({', '.join(cameras)})" for reason, cameras in reasons.items())
    return f"The scene starts {name} at ({x:.3f}, {y:.3f}, {z:.3f}) m: {told}. Move it, or a camera of sensors.yaml"


def find_remote(path: Path, seed: int, robot: Robot, sensors: Sensors) -> Iterator[Problem]:
    """Objects of a scene that start beyond the reach of a fixed robot at home, or in view of none of its cameras."""
    spec, located, profile = place_scene(read_scene(path), robot[0].placement), read_yaml(path), robot[0]
    model = compile_scene([robot], spec, seed).model
    data, cameras = pose_start(model, [robot]), [each.camera for each in sensors.cameras.values() if each.camera]
    for name, body in spec.bodies.items():
        if body.fixed or body.joint or body.part_of or not body.listed:
            continue
        at, far_m = ("bodies", name, "place"), BAND_SHARE * profile.grasp_band_m[1]
        away_m = math.dist(data.body(name).xpos[:2], profile.mount_position_m[:2])
        if profile.base is None and away_m > far_m:
            found, expected = f"{name!r}, {away_m:.2f} m from {profile.target}", f"at most {far_m:.2f} m"
            yield located.problem("OUT_OF_REACH", at, found, expected, "Move it nearer.")
        reasons = dict.fromkeys(_find_reason(model, data, name, each) for each in cameras)
        if reasons and not any(each.startswith(IN_VIEW) for each in reasons):
            found = f"{name!r}: {'; '.join(reasons)}"
            yield located.problem("OBJECT_HIDDEN", at, found, "in view of a camera", "Move it, or a camera.")


def _find_reason(model: mujoco.MjModel, data: mujoco.MjData, name: str, camera: CameraSettings) -> str:
    mounting = find_mounting(model, camera)
    if mounting is None:
        return "no such camera in the scene"
    view, lens, own = mounting.find(data), mounting.lens, model.body(name).id
    way_m = data.xpos[own] - view.position_m
    x, y, z = view.rotation.T @ way_m
    u, v = (lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy) if z > 0.0 else (-1.0, -1.0)
    if not (0.0 <= u < lens.width and 0.0 <= v < lens.height):
        return "outside of the picture"
    if not camera.range_m[0] <= z <= camera.range_m[1]:
        return f"outside of the range, {z:.2f} m away"
    geoms = [_cast(model, data, view.position_m, way_m, without) for without in (-1, own)]
    hit, behind = (model.body(model.geom_bodyid[geom]).name if geom >= 0 else "" for geom in geoms)
    if hit not in (name, ""):
        return f"hidden by {hit}"
    materials = [(geom, model.geom_matid[geom]) for geom in geoms if geom >= 0]
    shades = [(model.mat_rgba[of] if of >= 0 else model.geom_rgba[geom])[:3] for geom, of in materials]
    if len(shades) == 2 and np.abs(shades[0] - shades[1]).max() < ALIKE_RGB:
        return f"of the colour of {behind} behind it"
    return f"{IN_VIEW}, and too small or too far for a sure look"


def _cast(model: mujoco.MjModel, data: mujoco.MjData, from_m: np.ndarray, way_m: np.ndarray, without: int) -> int:
    """The first geom on a way (3,), but for those of one body; -1 when there is none."""
    geom = np.zeros(1, dtype=np.int32)
    mujoco.mj_ray(model, data, from_m, way_m, _DRAWN, 1, without, geom)
    return int(geom[0])
