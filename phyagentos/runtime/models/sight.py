"""Why no camera shows a thing of a scene: asked when a session names what was never seen, to tell its author."""

import mujoco
import numpy as np

from phyagentos.protocol.settings.cameras import CameraSettings
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.models.camera_model import find_mounting
from phyagentos.runtime.models.world import Robot, compile_scene

ALIKE_RGB = 0.12  # of two colours that noise and shadow make one
_DRAWN = np.ones(6, dtype=np.uint8)


def explain_unseen(spec: SceneSpec, name: str, seed: int, robot: Robot, sensors: Sensors) -> str:
    """Where a body of the scene starts, and for each camera, with the robot at home, what keeps it from seeing it."""
    model = compile_scene([robot], spec, seed).model
    data = mujoco.MjData(model)
    arm, servoed = robot[0].arm, robot[0].servoed  # a base stands at home
    for joint, angle_rad in zip(arm.joints[servoed], arm.home_rad[servoed], strict=True):
        data.joint(joint).qpos = angle_rad
    mujoco.mj_fwdPosition(model, data)
    reasons: dict[str, list[str]] = {}
    for camera, sensor in sensors.cameras.items():
        if sensor.camera is not None:
            reasons.setdefault(_find_reason(model, data, name, sensor.camera), []).append(camera)
    x, y, z = data.body(name).xpos
    told = "; ".join(f"{reason} ({', '.join(cameras)})" for reason, cameras in reasons.items())
    return f"The scene starts {name} at ({x:.3f}, {y:.3f}, {z:.3f}) m: {told}. Move it, or a camera of sensors.yaml"


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
    return "in view, and too small or too far for a sure look"


def _cast(model: mujoco.MjModel, data: mujoco.MjData, from_m: np.ndarray, way_m: np.ndarray, without: int) -> int:
    """The first geom on a way (3,), but for those of one body; -1 when there is none."""
    geom = np.zeros(1, dtype=np.int32)
    mujoco.mj_ray(model, data, from_m, way_m, _DRAWN, 1, without, geom)
    return int(geom[0])
