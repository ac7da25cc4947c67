"""Physics steps of one robot alone, one after another in compiled code, up to the first that asks for more.

Between two steps Python costs as much as a step. Of each step the same is judged as outside: a servo input that needs
a bound ends a stride before its step, a torque that a joint sensor feels ends it after its step. A fatal error of
MuJoCo ends the process here, as the loss of a target, where its Python binding raises.
"""

import ctypes
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
from numba import njit
from numba.core.types import ExternalFunction, intp, void

from phyagentos.runtime.drivers.mujoco.joint_sensors import FELT_NM
from phyagentos.runtime.drivers.mujoco.local_limits import LocalLimits
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.robot_state import Array

_mj_step = ExternalFunction("mj_step", void(intp, intp))  # of addresses of a model and its data


@dataclass(frozen=True, slots=True)
class Stride:
    """Steps that were taken, and whether the last of them is felt by a joint's sensor."""

    steps: int
    is_felt: bool


NO_STRIDE = Stride(0, is_felt=False)


class Strider:
    """Takes strides of a robot on a fixed mount, with its servos within their own limits."""

    def __init__(self, physics: Physics, limits: LocalLimits) -> None:
        _load_mujoco()
        self._physics = physics
        places = np.arange(max(physics.model.nq, physics.model.nu), dtype=np.intp)
        state, actuation = physics.state, physics.actuation
        self._places = (
            places[actuation.inputs], places[actuation.servos], places[state.q_address], places[state.v_address]
        )  # fmt: skip
        self._bounds = limits.middle, *limits.free
        self.take(np.empty((0, len(self._places[0]))))  # loads what is compiled, which in real time would take too long

    def take(self, controls: Array) -> Stride:
        """The steps of as many rows (n, n_inputs) of servo inputs as need nothing else; possibly none."""
        model, data = self._physics.model, self._physics.data
        state = data.ctrl, data.qpos, data.qfrc_constraint
        return Stride(*_take(model._address, data._address, state, self._places, controls, self._bounds))


@njit(cache=True, nogil=True)
def _take(model, data, state, places, controls, bounds):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """How many rows were carried out, and whether the last one is felt."""
    (ctrl, qpos, torques), (inputs, servos, joints, dofs), (middle, free_step, free_room) = state, places, bounds
    for row in range(len(controls)):
        for k, place in enumerate(inputs):
            ctrl[place] = controls[row, k]
        for k, place in enumerate(joints):
            q = qpos[place]
            if not (abs(ctrl[servos[k]] - q) <= free_step[k] and abs(q - middle[k]) <= free_room[k]):
                return row, False
        _mj_step(model, data)
        for place in dofs:
            if abs(torques[place]) > FELT_NM:
                return row + 1, True
    return len(controls), False


@cache
def _load_mujoco() -> None:
    """Let compiled code find the library that is loaded already."""
    ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco.*"))), ctypes.RTLD_GLOBAL)
