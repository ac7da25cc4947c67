"""A robot alone, at home, with the frame of its tool: for authors of its profile."""

from pathlib import Path

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError
from phyagentos.geometry import rotate
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.mujoco.rendering import render_png
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.hand import measure_hand
from phyagentos.runtime.models.robot import build_robot
from phyagentos.runtime.models.scene import aim
from phyagentos.runtime.models.sources import find_models

AXES = {
    (1.0, 0.0, 0.0): (0.9, 0.2, 0.2, 1.0),
    (0.0, 1.0, 0.0): (0.2, 0.7, 0.2, 1.0),
    (0.0, 0.0, 1.0): (0.2, 0.3, 0.9, 1.0),
}
LENGTH_M, RADIUS_M = 0.1, 0.004
WIDTH, HEIGHT, FOV_DEG = 800, 600, 40.0


def draw_robot(profile: TargetProfile, folder: Path) -> bytes:
    """PNG of a robot; raises DefinitionError of its model, or `NO_GRAPHICS`."""
    spec = build_robot(profile, folder)
    tool = spec.site(profile.tcp)
    for axis, color in AXES.items():
        end = np.array(tool.pos) + LENGTH_M * np.array(rotate(tool.quat, axis))
        tool.parent.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*tool.pos, *end], size=[RADIUS_M, 0, 0], rgba=color,
            contype=0, conaffinity=0, mass=0.0, group=2,
        )  # fmt: skip
    spec.worldbody.add_light(pos=[1.5, -1.5, 3.0], dir=[-0.4, 0.4, -1.0])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2.0, 2.0, 0.1], rgba=[0.85, 0.86, 0.88, 1.0])
    probe = compile_model(spec, *find_models(profile, folder))
    data = _pose(probe, profile, folder)
    low, high = data.geom_xpos[:-1].min(axis=0), data.geom_xpos[:-1].max(axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low)) + 0.3
    eye = middle + reach * np.array((1.0, -1.0, 0.6))
    spec.worldbody.add_camera(name="portrait", pos=eye, fovy=FOV_DEG, xyaxes=aim(eye, middle))
    model = spec.compile()
    taken = render_png(model, _pose(model, profile, folder), "portrait", WIDTH, HEIGHT)
    if "picture.png" not in taken.artefacts:
        raise DefinitionError.of("NO_GRAPHICS", profile.target, taken.reason, "MuJoCo's graphics", "See `paos doctor`.")
    return taken.artefacts["picture.png"].data


def _pose(model: mujoco.MjModel, profile: TargetProfile, folder: Path) -> mujoco.MjData:
    data, hand = mujoco.MjData(model), measure_hand(profile, folder)
    postures = {**dict(zip(profile.arm.joints, profile.arm.home_rad, strict=True))}
    postures |= dict(zip(hand.joints, hand.pose(profile.gripper.max_width_m), strict=True))
    for name, position in postures.items():
        data.qpos[model.joint(name).qposadr[0]] = position
    mujoco.mj_forward(model, data)
    return data
