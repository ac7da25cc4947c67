"""Says from a recorded simulator state whether a cube lies in a tray, and the like.

It loads `scene.mjb` and `terminal.npz` with MuJoCo and numpy, a model no larger than its file; nothing of the framework
that acted is imported.
"""

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.pictures.model_file import read_model
from phyagentos.protocol.workspace.array_files import read_arrays

RIM_MARGIN_M = 0.002
REST_SPEED_M_S = 0.05


def is_in_tray(folder: Path, cube: str, tray: str) -> bool:
    """Whether the centre of a free body is between the walls of a `tray` of boxes, under its rim, and at rest."""
    model, data = read_end(folder)
    cube_id, tray_id = model.body(cube).id, model.body(tray).id
    lower, upper = _compute_box(model, tray_id)
    rotation = data.xmat[tray_id].reshape(3, 3)
    position = rotation.T @ (data.xpos[cube_id] - data.xpos[tray_id])
    dof = model.body_dofadr[cube_id]
    at_rest = float(np.linalg.norm(data.qvel[dof : dof + 3])) < REST_SPEED_M_S
    inside = bool(np.all(position[:2] > lower[:2]) and np.all(position[:2] < upper[:2]))
    half_m = float(model.geom_size[model.body_geomadr[cube_id]].min())
    low_enough = position[2] - half_m < upper[2] - RIM_MARGIN_M
    return inside and bool(low_enough) and bool(position[2] > lower[2]) and at_rest


def read_end(folder: Path) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The model of a bundle and its last state, with all that follows from it."""
    model = read_model(folder / "scene.mjb")
    data = mujoco.MjData(model)
    terminal = read_arrays(folder / "terminal.npz")
    data.qpos[:], data.qvel[:] = terminal["qpos"], terminal["qvel"]
    mujoco.mj_forward(model, data)
    return model, data


def _compute_box(model: mujoco.MjModel, body: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bounds (3,), (3,) of a body's boxes in its own frame [m]."""
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        if model.geom_contype[geom] == 0 and model.geom_conaffinity[geom] == 0:
            continue
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
        reach = np.abs(matrix.reshape(3, 3)) @ model.geom_size[geom]
        lower = np.minimum(lower, model.geom_pos[geom] - reach)
        upper = np.maximum(upper, model.geom_pos[geom] + reach)
    return lower, upper
