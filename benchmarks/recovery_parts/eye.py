"""More of the eye of its own: what stands on what, and what stands in a marked area, from a recorded simulator state.

Like `judge`, it uses MuJoCo and numpy alone; nothing of the framework that acted is imported.
"""

from pathlib import Path

import mujoco
import numpy as np

REST_SPEED_M_S = 0.05
TOUCH_M = 0.004  # between a bottom and the top that carries it


def is_on(folder: Path, upper: str, lower: str) -> bool:
    """Whether `upper` rests on the top of `lower`: centre over it, bottom at its top, at rest.

    Args:
        folder: An evidence bundle.
        upper: Body name of a free body made of one box.
        lower: Body name of a body made of one box.
    """
    model, data = _load(folder)
    high, low = model.body(upper).id, model.body(lower).id
    bottom_m = data.xpos[high][2] - _half_height(model, data, high)
    top_m = data.xpos[low][2] + _half_height(model, data, low)
    reach = float(model.geom_size[model.body_geomadr[low]][:2].min())
    offset = np.abs(data.xpos[high][:2] - data.xpos[low][:2])
    return bool(abs(bottom_m - top_m) < TOUCH_M and np.all(offset < reach)) and _is_at_rest(model, data, high)


def is_in_box(folder: Path, name: str, middle_m: tuple[float, float], half_m: tuple[float, float]) -> bool:
    """Whether the centre of a free body is over a level rectangle of the world, at rest.

    Args:
        folder: An evidence bundle.
        name: Body name.
        middle_m: (2,) of the rectangle.
        half_m: (2,) half sides, along the axes of the world.
    """
    model, data = _load(folder)
    body = model.body(name).id
    inside = np.all(np.abs(data.xpos[body][:2] - np.array(middle_m)) <= np.array(half_m))
    return bool(inside) and _is_at_rest(model, data, body)


def _load(folder: Path) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    data = mujoco.MjData(model)
    with np.load(folder / "terminal.npz") as terminal:
        data.qpos[:] = terminal["qpos"]
        data.qvel[:] = terminal["qvel"]
    mujoco.mj_kinematics(model, data)
    return model, data


def _half_height(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> float:
    geom = model.body_geomadr[body]
    return float(np.abs(data.geom_xmat[geom].reshape(3, 3)[2]) @ model.geom_size[geom])


def _is_at_rest(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> bool:
    dof = model.body_dofadr[body]
    return float(np.linalg.norm(data.qvel[dof : dof + 3])) < REST_SPEED_M_S
