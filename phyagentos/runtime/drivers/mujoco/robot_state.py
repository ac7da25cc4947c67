"""One robot's part of a compiled scene: its joints, its base, its fingers, and the whole state of the simulation."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.drivers.mujoco.joint_sensors import JointSensors
from phyagentos.runtime.drivers.mujoco.planar_base import PlanarBase
from phyagentos.runtime.models.world import CompiledScene

Array = NDArray[np.float64]
RANGE_TOLERANCE_RAD = 1e-3  # what a contact may press a joint beyond its range
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


class RobotState:
    """Where a robot stands and how it moves; several may share the scene, `prefix` is of its names in the model.

    Attributes:
        base: None for an arm on a fixed mount.
        servoed: Which of the profile's joints are servoed; those before them are the base's.
        q_address, v_address: Where positions and velocities of the servoed joints are.
        q_range: (2, n_joints) lowest and highest positions of all joints.
        fingers: (k,) where positions of the hand's joints are.
    """

    def __init__(self, profile: TargetProfile, scene: CompiledScene, prefix: str = "") -> None:
        model = scene.model
        self.scene, self.model, self.data = scene, model, scene.data
        self.profile, self.prefix, self.hand = profile, prefix, scene.hands[profile.target]
        self._sensors = JointSensors(profile.arm, scene.seed, profile.physics_step_s)
        self.base = PlanarBase(model, profile, prefix) if profile.base is not None else None
        self.servoed = profile.servoed
        joints = [model.joint(prefix + name) for name in profile.arm.joints[self.servoed]]
        self.q_address = as_slice([int(joint.qposadr[0]) for joint in joints])
        self.v_address = as_slice([int(joint.dofadr[0]) for joint in joints])
        self.q_range = np.array([joint.range for joint in joints]).reshape(-1, 2).T
        if self.base is not None:
            self.q_range = np.column_stack(((self.base.q_min, self.base.q_max), self.q_range))
        self.fingers = self._find_places(self.hand.joints)
        self._driven = self._find_places(profile.gripper.joints)
        self._travel = np.array(profile.gripper.travel or np.ones(len(self._driven)))

    def measure_hand_friction(self) -> float:
        """Dry friction of the joints of the hand against its drive, from closed to open [N]."""
        hand = self.hand
        if not hand.joints:
            return 0.0
        moved = np.abs(hand.postures[-1] - hand.postures[0]) / abs(hand.drive[-1] - hand.drive[0])
        dofs = [int(self.model.joint(self.prefix + name).dofadr[0]) for name in hand.joints]
        return float(moved @ self.model.dof_frictionloss[dofs])

    def _find_places(self, joints: Sequence[str]) -> NDArray[np.intp]:
        return np.array([int(self.model.joint(self.prefix + name).qposadr[0]) for name in joints], dtype=np.intp)

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return float(self.data.time)

    @property
    def q_rad(self) -> Array:
        """(n_joints,) joint positions, as the encoders measure them."""
        return self.measure_joints()[0]

    @property
    def qd_rad_s(self) -> Array:
        """(n_joints,) joint velocities, as the encoders measure them."""
        return self.measure_joints()[1]

    def measure_joints(self) -> tuple[Array, Array]:
        """(n_joints,) positions [rad] and velocities [rad/s], as the encoders measure them."""
        return self._sensors.measure(*self.read_joints(self.data), float(self.data.time))

    def read_joints(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """(n_joints,) true positions and velocities, those of the base first."""
        q, qd = data.qpos[self.q_address], data.qvel[self.v_address]
        if self.base is None:
            return q, qd
        return np.concatenate((self.base.read_pose(data), q)), np.concatenate((self.base.read_rate(data), qd))

    @property
    def posture_address(self) -> NDArray[np.intp]:
        """Where in qpos `write_posture` writes: the whole pose of a free base, then the arm's joints."""
        joints = np.arange(self.model.nq, dtype=np.intp)[self.q_address]
        return joints if self.base is None else np.r_[self.base.free_q : self.base.free_q + 7, joints]

    def write_posture(self, data: mujoco.MjData, q_rad: Array) -> None:
        """Put base and arm at joint positions (n_joints,) in a state."""
        if self.base is not None:
            self.base.write_pose(data, q_rad[: self.servoed.start])
        data.qpos[self.q_address] = q_rad[self.servoed]

    @property
    def gripper_width_m(self) -> float:
        """Opening between the pads."""
        return self.hand.compute_width(float((self._travel * self.data.qpos[self._driven]).sum()))

    def restore(self, state: Array) -> None:
        """Continue from a recorded state vector, bit for bit."""
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        mujoco.mj_fwdPosition(self.model, self.data)  # contacts; the next step computes them anew

    def refuse_bad_state(self, state: Array) -> None:
        """Refuse a state of another length, with non-finite numbers, or outside the limits of the joints.

        Raises:
            ExecutionError: `MALFORMED`, `TARGET_LIMIT`.
        """
        size = mujoco.mj_stateSize(self.model, _STATE)
        if state.shape != (size,) or state.dtype != np.float64 or not np.isfinite(state).all():
            raise ExecutionError("MALFORMED", f"a state of shape {state.shape}; expected ({size},), all finite")
        data = mujoco.MjData(self.model)
        mujoco.mj_setState(self.model, data, state, _STATE)
        q, qd = self.read_joints(data)
        low, high = self.q_range
        if (q < low - RANGE_TOLERANCE_RAD).any() or (q > high + RANGE_TOLERANCE_RAD).any():
            raise ExecutionError("TARGET_LIMIT", "the state has a joint outside its range")
        if (np.abs(qd) > np.array(self.profile.arm.velocity_rad_s)).any():
            raise ExecutionError("TARGET_LIMIT", "the state has a joint that is faster than its limit")

    def read_state(self) -> Array:
        """The mjSTATE_INTEGRATION vector."""
        state = np.zeros(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state


def as_slice(places: list[int]) -> slice | NDArray[np.intp]:
    """Places in an array; a slice where they are consecutive, since a view costs less than a copy."""
    first, count = next(iter(places), 0), len(places)
    return slice(first, first + count) if places == list(range(first, first + count)) else np.array(places)
