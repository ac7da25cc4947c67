"""What acts on one robot in a compiled scene: servos, finger drive, motors of a base, friction, outer forces."""

import mujoco
import numpy as np

from phyagentos.runtime.drivers.mujoco.locomotion import make_locomotion
from phyagentos.runtime.drivers.mujoco.robot_state import Array, RobotState, as_slice
from phyagentos.runtime.models.robot import GRIPPER_ACTUATOR, name_actuator

RIGID = 0.9999  # constraint impedance of what must not give way
FREE = 6  # degrees of freedom of a body that nothing holds
CLOSING_M_S = 0.05  # fingers that move faster press on nothing that stays
FULL_LEAD_M = 0.001  # behind their set-point by so much, fingers get all that overcomes their friction
FORCE_UNIT_N = 1.0  # of the grip force that follows from the motor's current; its scale error is not simulated


class Actuation:
    """Inputs of a robot's motors, and what faults do to its joints, its pads and the bodies of its world.

    Attributes:
        inputs: Places of the servos and of the finger drive in `data.ctrl`; `servos` without the latter.
        lead_s: (k,) by how much damping delays each servo [s].
        sway: (n_joints,) by how much a joint may be faster than its set-points.
        pads: Geoms of the finger pads.
    """

    def __init__(self, state: RobotState) -> None:
        self._state, self._model, self._data = state, state.model, state.data
        model, profile, prefix, own = state.model, state.profile, state.prefix, state.servoed
        self._locomotion = make_locomotion(model, state.base, profile) if state.base is not None else None
        self._scratch = mujoco.MjData(model)
        self.sway = np.zeros(len(profile.arm.joints))
        self.sway[: own.start] = self._locomotion.sway if self._locomotion is not None else ()
        self._goal = np.zeros((2, own.start))  # pose and speeds that the base follows
        servos = [model.actuator(prefix + name_actuator(name)).id for name in profile.arm.joints[own]]
        drives = [model.actuator(prefix + GRIPPER_ACTUATOR).id] if profile.gripper.joints else []
        self.servos, self.inputs = as_slice(servos), as_slice([*servos, *drives])
        self._drive = np.array(drives, dtype=np.intp)  # empty without a gripper
        self._hand_friction_n = state.measure_hand_friction()
        self.lead_s = np.array(profile.arm.damping_nms_rad[own]) / np.array(profile.arm.stiffness_nm_rad[own])
        self.pads = [model.geom(prefix + name).id for name in profile.gripper.pads]
        gripping = model.geom_priority > model.geom_priority[self.pads].max(initial=0)  # whose own friction decides
        gripping[self.pads] = True
        self._gripping = np.flatnonzero(gripping)
        self._grip_friction = np.array(model.geom_friction[self._gripping])
        self._pad_pairs = np.flatnonzero(np.isin(model.pair_geom1, self.pads) | np.isin(model.pair_geom2, self.pads))
        self._pair_friction = np.array(model.pair_friction[self._pad_pairs])
        self._joint_friction = np.array(model.dof_frictionloss)
        self._joint_impedance = np.array(model.dof_solimp[:, :2])

    @property
    def commanded_width_m(self) -> float:
        """Opening that the drive is commanded now."""
        return self._state.hand.compute_width(float(self._data.ctrl[self._drive].sum()))

    def place_at_home(self) -> None:
        """Write the home posture with an open gripper, and let the servos hold it; before time begins."""
        home = np.array(self._state.profile.arm.home_rad)
        width = self._state.profile.gripper.max_width_m
        if self._state.base is not None:
            self._state.base.place(self._data, home[: self._state.servoed.start])
        self._state.write_posture(self._data, home)
        self._data.qpos[self._state.fingers] = self._state.hand.pose(width)
        self.begin()
        self.set_servos(home, np.zeros_like(home), width)

    def compute_controls(self, q_rad: Array, qd_rad_s: Array, gripper_width_m: Array) -> Array:
        """(n, n_inputs) of `inputs` for n physics steps; damping leads by kv/kp so that the servo does not lag."""
        servos, own = len(self.lead_s), self._state.servoed
        controls = np.empty((len(q_rad), servos + len(self._drive)))
        controls[:, :servos] = q_rad[:, own] + self.lead_s * qd_rad_s[:, own]
        controls[:, servos:] = self._overcome_friction(self._state.hand.compute_drive(gripper_width_m))[:, None]
        return controls

    def _overcome_friction(self, drive: Array) -> Array:
        """Set-points (n,) of the finger drive, further on by what the dry friction of the hand would hold back."""
        if not self._hand_friction_n:
            return drive
        lead = self._hand_friction_n / self._state.profile.gripper.stiffness_n_m
        behind = drive - float(self._data.actuator_length[self._drive].sum())
        return drive + lead * np.clip(behind / FULL_LEAD_M, -1.0, 1.0)

    def lead_base(self, q_rad: Array, qd_rad_s: Array) -> None:
        """Pose and speeds of the base in the coming physics steps, first of those of all joints (n_joints,)."""
        if self._state.base is not None:
            self._goal = np.array((q_rad, qd_rad_s))[:, : self._state.servoed.start]

    def begin(self) -> None:
        """A base that walks or drives begins anew, standing: an episode or a session begins."""
        if self._locomotion is not None:
            self._locomotion.begin(self._data)

    def drive(self) -> None:
        """Set the motors of a base for the coming physics step, and let the arm bear its own weight.

        An arm on a fixed mount is compensated without a reaction on it; on a base, its servos add what gravity asks.
        """
        if self._locomotion is not None:
            self._data.qfrc_applied[self._state.v_address] = self._compute_bias()[self._state.v_address]
            self._locomotion.control(self._data, *self._goal)

    def _compute_bias(self) -> Array:
        """(nv,) forces of gravity and motion in the present state; those in the data are of a physics step before."""
        now = self._scratch
        now.qpos[:], now.qvel[:] = self._data.qpos, self._data.qvel
        mujoco.mj_kinematics(self._model, now)
        mujoco.mj_comPos(self._model, now)
        mujoco.mj_comVel(self._model, now)
        mujoco.mj_rne(self._model, now, 0, now.qfrc_bias)
        return np.array(now.qfrc_bias)

    def find_lag(self, q_rad: Array) -> float:
        """Largest distance of a measured joint from its set-point (n_joints,), of those that follow one."""
        first = 0 if self._locomotion is None or self._locomotion.follows else self._state.servoed.start
        return float(np.abs(self._state.q_rad - q_rad)[first:].max(initial=0.0))

    def set_servos(self, q_rad: Array, qd_rad_s: Array, gripper_width_m: float) -> None:
        """Servo inputs of the coming physics steps."""
        row = self.compute_controls(q_rad[None], qd_rad_s[None], np.array([gripper_width_m]))[0]
        self._data.ctrl[self.inputs] = row
        self.lead_base(q_rad, qd_rad_s)

    def measure_grip(self) -> float | None:
        """Force that presses the fingers together [N], by the drive's current less what the hand's own friction takes.

        While they move it is none.
        """
        if not len(self._drive):
            return None
        moves = abs(float(self._data.actuator_velocity[self._drive].sum())) > CLOSING_M_S
        force_n = -float(self._data.actuator_force[self._drive].sum()) - self._hand_friction_n
        return 0.0 if moves else FORCE_UNIT_N * max(round(force_n / FORCE_UNIT_N), 0)

    def pull(
        self, name: str, wanted: Array, stiffness: float, damping: float, *, spin_damping: float, carries_weight: bool
    ) -> None:
        """Apply a hand's force towards `wanted` (3,) [m] to a body during the next physics step.

        Stiffness [1/s^2] and damping [1/s] are per unit of mass, spin damping [1/s] is per unit of inertia.
        """
        body = self._model.body(name).id
        dof = int(self._model.body_dofadr[body])
        mass, inertia = float(self._model.body_subtreemass[body]), self._model.body_inertia[body]
        velocity, spin = np.zeros(3), np.zeros(3)
        if self._model.body_dofnum[body] == FREE:  # what hangs on a joint is only held back by that joint
            velocity, spin = self._data.qvel[dof : dof + 3], self._data.qvel[dof + 3 : dof + 6]
        force = mass * (stiffness * (wanted - self._data.xpos[body]) - damping * velocity)
        if carries_weight:
            force = force - mass * self._model.opt.gravity
        rotation, axes = self._data.xmat[body].reshape(3, 3), self._data.ximat[body].reshape(3, 3)
        self._data.xfrc_applied[body, :3] = force  # each axis by its own inertia: a rod's is small about its length
        self._data.xfrc_applied[body, 3:] = axes @ (-spin_damping * inertia * (axes.T @ rotation @ spin))

    def let_go(self, name: str) -> None:
        """Remove the hand's force from a body."""
        self._data.xfrc_applied[self._model.body(name).id] = 0.0

    def push(self, joint: str, force_n: Array) -> None:
        """Apply a force (3,) in the world to the link of a joint, at its centre of mass, until the next push."""
        self._data.xfrc_applied[int(self._model.joint(self._state.prefix + joint).bodyid[0]), :3] = force_n

    def set_pad_friction(self, friction: tuple[float, float, float] | None) -> None:
        """Friction (slide, spin, roll) of the finger pads, and of what decides over them; None for the model's."""
        self._model.geom_friction[self._gripping] = self._grip_friction if friction is None else friction
        own = self._pair_friction
        self._model.pair_friction[self._pad_pairs] = own if friction is None else np.repeat(friction, (2, 1, 2))

    def set_joint_friction(self, joint: str, torque_nm: float | None) -> None:
        """Dry friction of a joint [Nm]; None for the model's."""
        dof = int(self._model.joint(self._state.prefix + joint).dofadr[0])
        own = torque_nm is None
        self._model.dof_frictionloss[dof] = self._joint_friction[dof] if own else torque_nm
        self._model.dof_solimp[dof, :2] = self._joint_impedance[dof] if own else RIGID  # a soft friction would creep
