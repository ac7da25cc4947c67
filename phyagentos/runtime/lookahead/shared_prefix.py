"""The shared beginning of all imagined worlds: the recording until the robot first comes near a thing.

Until then worlds differ only in where things are. So a world is composed of the recorded robot and the drawn things.
"""

import copy

import mujoco
import numpy as np

from phyagentos.runtime.lookahead.estimate import Array
from phyagentos.runtime.lookahead.rehearsal import STATE_STEPS, Rehearsal

NEAR_M = 0.03  # more than what a pose is wrong by, at three standard deviations of a thing that is seen badly

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


class SharedPrefix:
    """The beginning that all worlds of a recording share: `steps` physics steps that need not be played.

    Drawn things take `settle_steps` to come to rest, before anything is near them. With conditions that must hold all
    through, nothing is left out.
    """

    def __init__(self, rehearsal: Rehearsal, settle_steps: int) -> None:
        self._model = rehearsal.stage.physics.model
        self._bodies = [self._model.body(entity.name).id for entity in rehearsal.stage.physics.entities]
        index = 0 if rehearsal.session.hold else self._find_near(rehearsal.states) - -(-settle_steps // STATE_STEPS)
        self.steps = max(0, index) * STATE_STEPS
        self._state = rehearsal.states[index] if index > 0 else None
        joints = np.flatnonzero(np.isin(self._model.jnt_bodyid, self._bodies))
        self._joints: list[int] = joints.tolist()

    def put(self, state: Array) -> Array:
        """The mjSTATE_FULLPHYSICS of a world after the head start, from that at its beginning."""
        if self._state is None:
            return state
        model = self._model
        drawn, ahead = mujoco.MjData(model), mujoco.MjData(model)
        mujoco.mj_setState(model, drawn, state, _FULL)
        mujoco.mj_setState(model, ahead, self._state, _FULL)
        for joint in self._joints:
            q, v = _find_places(model, joint)
            ahead.qpos[q], ahead.qvel[v] = drawn.qpos[q], drawn.qvel[v]
        put = np.zeros_like(state)
        mujoco.mj_getState(model, ahead, put, _FULL)
        return put

    def _find_near(self, states: Array) -> int:
        """Index of the first state in which the robot is near a thing; that of the last one when none is."""
        model = copy.copy(self._model)
        of_things = np.isin(model.geom_bodyid, self._bodies)
        model.geom_margin[of_things] += NEAR_M
        data = mujoco.MjData(model)
        for index, state in enumerate(states):
            mujoco.mj_setState(model, data, state, _FULL)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            is_thing = of_things[data.contact.geom[: data.ncon]]
            if (is_thing[:, 0] != is_thing[:, 1]).any():
                return index
        return len(states) - 1


def _find_places(model: mujoco.MjModel, joint: int) -> tuple[slice, slice]:
    """Where the position and the velocity of a joint are."""
    q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    is_free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    return slice(q, q + (7 if is_free else 1)), slice(v, v + (6 if is_free else 1))
