"""Whether a recorded state may become the present: only a state that the robot could have been in.

Upstream: `world`, before it restores. A state is written at the beginning of an episode and never after.
"""

import mujoco
import numpy as np

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.mujoco.physics import Array, Physics

RANGE_TOLERANCE_RAD = 1e-3  # what a contact may press a joint beyond its range


def refuse_bad_state(state: Array, physics: Physics, profile: TargetProfile) -> None:
    """Refuse a state of another length, with numbers that are none, or outside the limits of the joints.

    Raises:
        ExecutionError: `MALFORMED`, `TARGET_LIMIT`.
    """
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    size = mujoco.mj_stateSize(physics.model, kind)
    if state.shape != (size,) or state.dtype != np.float64 or not np.isfinite(state).all():
        raise ExecutionError("MALFORMED", f"a state of shape {state.shape}; expected ({size},), all finite")
    data = mujoco.MjData(physics.model)
    mujoco.mj_setState(physics.model, data, state, kind)
    q, qd = data.qpos[physics.q_address], data.qvel[physics.v_address]
    low, high = physics.q_range
    if (q < low - RANGE_TOLERANCE_RAD).any() or (q > high + RANGE_TOLERANCE_RAD).any():
        raise ExecutionError("TARGET_LIMIT", "the state has a joint outside its range")
    if (np.abs(qd) > np.array(profile.arm.velocity_rad_s)).any():
        raise ExecutionError("TARGET_LIMIT", "the state has a joint that is faster than its limit")
