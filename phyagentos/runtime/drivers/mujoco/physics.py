"""One robot in the physics of an episode: its joints, servos and pads, its contacts, and the queries on them.

Queries are computed in a second MjData and never touch the stepped state: a run with more queries has the same bits.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Self

import msgspec
import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.geometry import as_pose, turn
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Contents, Entity, Interior, Pose, TargetState
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.drivers.mujoco.joint_sensors import JointSensors
from phyagentos.runtime.drivers.mujoco.locomotion import make_locomotion
from phyagentos.runtime.drivers.mujoco.planar_base import PlanarBase
from phyagentos.runtime.drivers.mujoco.step_kernels import find_firm
from phyagentos.runtime.models.robot import GRIPPER_ACTUATOR, name_actuator
from phyagentos.runtime.models.world import CompiledScene, compile_scene

Array = NDArray[np.float64]
RANGE_TOLERANCE_RAD = 1e-3  # what a contact may press a joint beyond its range
RIGID = 0.9999  # constraint impedance of what must not give way
_FREE = 6  # degrees of freedom of a body that nothing holds
_ROBOT, _LOOSE, _FINGER = 1, 2, 4  # what a geom belongs to
CLOSING_M_S = 0.05  # fingers that move faster press on nothing that stays
FORCE_UNIT_N = 1.0  # of the grip force that follows from the motor's current; its scale error is not simulated
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


class Physics:
    """A robot in a compiled scene, which several may share; `prefix` is of the robot's names in the model."""

    def __init__(self, profile: TargetProfile, scene: CompiledScene, prefix: str = "") -> None:
        self.scene, self.model, self.data = scene, scene.model, scene.data
        self.entities, self.regions = scene.entities, scene.regions
        self.seen = mujoco.MjData(self.model)
        self._considered = mujoco.MjData(self.model)
        self._profile, self._prefix = profile, prefix
        self._sensors = JointSensors(profile.arm, scene.seed, profile.physics_step_s)
        model = self.model
        own = self._servoed = profile.servoed
        self.base = PlanarBase(model, profile, prefix) if profile.base is not None else None
        self._locomotion = make_locomotion(model, self.base, profile) if self.base is not None else None
        self.sway = np.zeros(len(profile.arm.joints))  # by how much a joint may be faster than its set-points
        self.sway[: own.start] = self._locomotion.sway if self._locomotion is not None else ()
        self._goal = np.zeros((2, own.start))  # pose and speeds that the base follows
        joints = [model.joint(prefix + name) for name in profile.arm.joints[own]]
        self._hand = scene.hands[profile.target]
        fingers = [model.joint(prefix + name) for name in self._hand.joints]
        driven = [model.joint(prefix + name) for name in profile.gripper.joints]
        self.q_address = _as_slice([int(joint.qposadr[0]) for joint in joints])
        self.v_address = _as_slice([int(joint.dofadr[0]) for joint in joints])
        self.q_range = np.array([joint.range for joint in joints]).reshape(-1, 2).T  # (2, n_joints): lowest, highest
        if self.base is not None:
            self.q_range = np.column_stack(((self.base.q_min, self.base.q_max), self.q_range))
        servos = [model.actuator(prefix + name_actuator(name)).id for name in profile.arm.joints[own]]
        self.servos = _as_slice(servos)
        drives = [model.actuator(prefix + GRIPPER_ACTUATOR).id] if profile.gripper.joints else []
        self._drive = np.array(drives, dtype=np.intp)  # empty without a gripper
        self.inputs = _as_slice([*servos, *drives])
        self._fingers = np.array([int(joint.qposadr[0]) for joint in fingers], dtype=np.intp)
        self._driven = np.array([int(joint.qposadr[0]) for joint in driven], dtype=np.intp)
        self._travel = np.array(profile.gripper.travel or np.ones(len(driven)))
        self._pads = [model.geom(prefix + name).id for name in profile.gripper.pads]
        self._jacobian = np.zeros((6, model.nv))
        self._tcp = model.site(prefix + profile.tcp).id
        self.lead_s = np.array(profile.arm.damping_nms_rad[own]) / np.array(profile.arm.stiffness_nm_rad[own])
        moving = {int(model.body_weldid[joint.bodyid[0]]) for joint in (*joints, *fingers)}
        if self.base is not None:
            moving = {int(model.body_weldid[body]) for body in self.base.list_guarded(model)}
        self._of_robot = np.array([int(model.body_weldid[body]) in moving for body in model.geom_bodyid])
        self._balls = np.array([model.body(name).id for name in scene.balls], dtype=np.intp)
        loose = {model.body(entity.name).id for entity in self.entities if entity.movable} | set(self._balls.tolist())
        is_loose = np.array([int(body) in loose for body in model.geom_bodyid])
        grips = [*(model.jnt_bodyid[joint.id] for joint in fingers), *(model.geom_bodyid[pad] for pad in self._pads)]
        gripping = [int(model.body_weldid[body]) for body in grips]  # a jaw may stand still
        of_fingers = np.isin(model.body_weldid[model.geom_bodyid], gripping)
        self._kinds = (_ROBOT * self._of_robot + _LOOSE * is_loose + _FINGER * of_fingers).astype(np.uint8)
        self._bodies = {model.body(entity.name).id: entity for entity in self.entities}
        self._movable = {entity.name for entity in self.entities if entity.movable}
        pads = np.array(self._pads, dtype=np.intp)
        decisive = model.geom_priority > model.geom_priority[pads].max(initial=0)  # whose own friction decides a grip
        self._gripping = np.union1d(pads, np.flatnonzero(decisive))
        self._grip_friction = np.array(model.geom_friction[self._gripping])
        self._pad_pairs = np.flatnonzero(np.isin(model.pair_geom1, self._pads) | np.isin(model.pair_geom2, self._pads))
        self._pair_friction = np.array(model.pair_friction[self._pad_pairs])
        self._joint_friction = np.array(model.dof_frictionloss)
        self._joint_impedance = np.array(model.dof_solimp[:, :2])

    @classmethod
    def alone(cls, profile: TargetProfile, folder: Path, spec: SceneSpec, seed: int) -> Self:
        """The only robot of a scene, whose model is in `folder`."""
        return cls(profile, compile_scene(((profile, folder),), spec, seed))

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
            self.base.write_pose(data, q_rad[: self._servoed.start])
        data.qpos[self.q_address] = q_rad[self._servoed]

    @property
    def gripper_width_m(self) -> float:
        """Opening between the pads."""
        return self._hand.compute_width(float((self._travel * self.data.qpos[self._driven]).sum()))

    @property
    def commanded_width_m(self) -> float:
        """Opening that the drive is told now."""
        return self._hand.compute_width(float(self.data.ctrl[self._drive].sum()))

    def start(self, settle_s: float) -> None:
        """Begin at time zero with the arm at home, and let things come to rest."""
        mujoco.mj_resetData(self.model, self.data)
        self.place_at_home()
        self.step(round(settle_s / self._profile.physics_step_s))

    def place_at_home(self) -> None:
        """Write the home posture with an open gripper, and let the servos hold it; before time begins."""
        home = np.array(self._profile.arm.home_rad)
        width = self._profile.gripper.max_width_m
        if self.base is not None:
            self.base.place(self.data, home[: self._servoed.start])
        self.write_posture(self.data, home)
        self.data.qpos[self._fingers] = self._hand.pose(width)
        self.begin()
        self.set_servos(home, np.zeros_like(home), width)

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
        if (np.abs(qd) > np.array(self._profile.arm.velocity_rad_s)).any():
            raise ExecutionError("TARGET_LIMIT", "the state has a joint that is faster than its limit")

    def read_state(self) -> Array:
        """The mjSTATE_INTEGRATION vector."""
        state = np.zeros(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state

    def compute_controls(self, q_rad: Array, qd_rad_s: Array, gripper_width_m: Array) -> Array:
        """(n, n_inputs) of `inputs` for n physics steps; damping leads by kv/kp so that the servo does not lag."""
        servos, own = len(self.lead_s), self._servoed
        controls = np.empty((len(q_rad), servos + len(self._drive)))
        controls[:, :servos] = q_rad[:, own] + self.lead_s * qd_rad_s[:, own]
        controls[:, servos:] = self._hand.compute_drive(gripper_width_m)[:, None]
        return controls

    def lead_base(self, q_rad: Array, qd_rad_s: Array) -> None:
        """Pose and speeds of the base in the coming physics steps, first of those of all joints (n_joints,)."""
        if self.base is not None:
            self._goal = np.array((q_rad, qd_rad_s))[:, : self._servoed.start]

    def begin(self) -> None:
        """A base that walks or drives begins anew, standing: an episode or a session begins."""
        if self._locomotion is not None:
            self._locomotion.begin(self.data)

    def drive(self) -> None:
        """Set the motors of a base for the coming physics step, and let the arm bear its own weight.

        An arm on a fixed mount is compensated without a reaction on it; on a base, its servos add what gravity asks.
        """
        if self._locomotion is not None:
            self.data.qfrc_applied[self.v_address] = self._compute_bias()[self.v_address]
            self._locomotion.control(self.data, *self._goal)

    def _compute_bias(self) -> Array:
        """(nv,) forces of gravity and motion in the present state; those in the data are of a physics step before."""
        now = self._considered
        now.qpos[:], now.qvel[:] = self.data.qpos, self.data.qvel
        mujoco.mj_kinematics(self.model, now)
        mujoco.mj_comPos(self.model, now)
        mujoco.mj_comVel(self.model, now)
        mujoco.mj_rne(self.model, now, 0, now.qfrc_bias)
        return np.array(now.qfrc_bias)

    def find_lag(self, q_rad: Array) -> float:
        """Largest distance of a measured joint from its set-point (n_joints,), of those that follow one."""
        first = 0 if self._locomotion is None or self._locomotion.follows else self._servoed.start
        return float(np.abs(self.q_rad - q_rad)[first:].max(initial=0.0))

    def set_servos(self, q_rad: Array, qd_rad_s: Array, gripper_width_m: float) -> None:
        """Servo inputs of the coming physics steps."""
        row = self.compute_controls(q_rad[None], qd_rad_s[None], np.array([gripper_width_m]))[0]
        self.data.ctrl[self.inputs] = row
        self.lead_base(q_rad, qd_rad_s)

    def step(self, count: int = 1) -> None:
        """Advance by `count` physics steps."""
        advance((self,), count)

    def look(self) -> None:
        """Compute poses of the present, for the queries below; ExecutionError where there is none."""
        if not np.isfinite(self.data.qpos).all():
            raise ExecutionError("TARGET_LOST", f"the simulation became unstable before {self.time_s:.3f} s")
        seen = self.seen
        seen.time = self.data.time
        seen.qpos[:] = self.data.qpos
        seen.qvel[:] = self.data.qvel
        mujoco.mj_kinematics(self.model, seen)

    def find_touching(self) -> dict[str, int]:
        """Entities that touched a pad in the latest physics step, with the number of pads."""
        touched: dict[str, set[int]] = {}
        for pair in self.data.contact.geom[: self.data.ncon].tolist():
            for pad, other in (pair, pair[::-1]):
                entity = self._bodies.get(int(self.model.geom_bodyid[other])) if pad in self._pads else None
                if entity is not None:
                    touched.setdefault(entity.name, set()).add(pad)
        return {name: len(pads) for name, pads in sorted(touched.items())}

    def read_target(self, touching: dict[str, int]) -> TargetState:
        """The arm's own state (after `look`); the pose of the tool follows from the measured joints."""
        q_rad, qd_rad_s = self.measure_joints()
        return TargetState(
            q_rad=tuple(q_rad.tolist()),
            qd_rad_s=tuple(qd_rad_s.tolist()),
            gripper_width_m=self.gripper_width_m,
            tcp=self._compute_tool(q_rad - self.read_joints(self.data)[0]),
            holding=tuple(n for n, pads in touching.items() if pads == len(self._pads) and n in self._movable),
            grip_force_n=self._measure_grip(),
            base=None if self.base is None else (float(q_rad[0]), float(q_rad[1]), float(q_rad[2])),
            trunk=None if self.base is None else self._read_pose(self.base.body),
        )

    def _measure_grip(self) -> float | None:
        """Force that presses the fingers together [N], by the drive's current; while they move it is friction."""
        if not len(self._drive):
            return None
        moves = abs(float(self.data.actuator_velocity[self._drive].sum())) > CLOSING_M_S
        force_n = -float(self.data.actuator_force[self._drive].sum())
        return 0.0 if moves else FORCE_UNIT_N * max(round(force_n / FORCE_UNIT_N), 0)

    def _compute_tool(self, error_rad: Array) -> Pose:
        """Pose of the tool centre point for joints (n_joints,) measured with a small error [rad] (after `look`)."""
        mujoco.mj_comPos(self.model, self.seen)
        mujoco.mj_jacSite(self.model, self.seen, self._jacobian[:3], self._jacobian[3:], self._tcp)
        columns = self._jacobian[:, self.v_address]
        if self.base is not None:
            columns = np.column_stack((self.base.compute_columns(self._jacobian, self.seen), columns))
        moved = columns @ error_rad
        rotation = turn(moved[3:]) @ self.seen.site_xmat[self._tcp].reshape(3, 3)
        return as_pose(rotation, self.seen.site_xpos[self._tcp] + moved[:3])

    def read_entities(self, holders: Mapping[str, str]) -> tuple[Entity, ...]:
        """Ground truth of every thing (after `look`); `holders` maps entities to the target that holds each."""
        found = []
        for body, entity in self._bodies.items():
            found.append(
                msgspec.structs.replace(
                    entity,
                    pose=self._read_pose(body),
                    speed_m_s=self._find_speed(body),
                    joint=self._find_opening(body),
                    held_by=holders.get(entity.name),
                    observed_at_s=self.time_s,
                    contents=self._count_balls(body, entity.interior),
                )
            )
        return tuple(found)

    def _read_pose(self, body: int) -> Pose:
        return Pose(tuple(self.seen.xpos[body].tolist()), tuple(self.seen.xquat[body].tolist()))

    def _count_balls(self, body: int, inside: Interior | None) -> Contents | None:
        """Balls whose middle is in the interior of a body; None for what has none, or where there are no balls."""
        if inside is None or not len(self._balls):
            return None
        local = (self.seen.xpos[self._balls] - self.seen.xpos[body]) @ self.seen.xmat[body].reshape(3, 3)
        count = int((np.abs(local - inside.center_m) <= inside.half_m).all(axis=1).sum())
        return Contents(count, count, self.time_s)

    def _find_speed(self, body: int) -> float:
        """Of a body's origin [m/s]; a part moves as its whole does, since it does not turn fast."""
        whole = int(self.model.body_weldid[body])
        dof = int(self.model.body_dofadr[whole])
        if self.model.body_dofnum[whole] == _FREE:
            return float(np.linalg.norm(self.data.qvel[dof : dof + 3]))
        if not self.model.body_dofnum[whole]:
            return 0.0
        joint = int(self.model.dof_jntid[dof])
        hinge = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        lever = np.cross(self.seen.xaxis[joint], self.seen.xpos[body] - self.seen.xanchor[joint])
        arm_m = float(np.linalg.norm(lever)) if hinge else 1.0
        return abs(float(self.data.qvel[dof])) * arm_m

    def _find_opening(self, body: int) -> float | None:
        """Fraction of its own joint's travel; None for what has none."""
        joint = int(self.model.body_jntadr[body])
        if joint < 0 or self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            return None
        low, high = self.model.jnt_range[joint]
        return float(np.clip((self.data.qpos[self.model.jnt_qposadr[joint]] - low) / (high - low), 0.0, 1.0))

    def find_position(self, name: str) -> Array:
        """(3,) of a body's frame in the world, as of the latest physics step."""
        return np.array(self.data.xpos[self.model.body(name).id])

    def find_tcp(self) -> tuple[Array, Array]:
        """(3,) position and (3, 3) rotation of the tool centre point, as of the latest physics step."""
        return np.array(self.data.site_xpos[self._tcp]), np.array(self.data.site_xmat[self._tcp]).reshape(3, 3)

    def is_held(self, name: str) -> bool:
        """Whether every pad touched the body in the latest physics step."""
        body = self.model.body(name).id
        geoms = self.data.contact.geom[: self.data.ncon].tolist()
        touched = {
            pad
            for first, second in geoms
            for pad, other in ((first, second), (second, first))
            if pad in self._pads and self.model.geom_bodyid[other] == body
        }
        return bool(touched) and len(touched) == len(self._pads)

    def find_clearance(self, point: Array, own: Array) -> float:
        """Horizontal distance from a point to the nearest movable thing that is not the one at `own` [m]."""
        others = [np.array(self.data.xpos[body]) for body, entity in self._bodies.items() if entity.movable]
        distances = [np.linalg.norm((point - other)[:2]) for other in others if np.linalg.norm(own - other) > 1e-6]
        return float(min(distances, default=1.0))

    def can_grasp_at(self, point: Array) -> bool:
        """Whether a point (3,) is in the band around the base in which the arm grasps."""
        nearest_m, farthest_m = self._profile.grasp_band_m
        base_m = self._profile.mount_position_m if self.base is None else self.data.xpos[self.base.body]
        away_m = np.linalg.norm(point[:2] - np.array(base_m[:2]))
        return bool(nearest_m <= away_m <= farthest_m)

    def pull(
        self, name: str, wanted: Array, stiffness: float, damping: float, *, spin_damping: float, carries_weight: bool
    ) -> None:
        """Apply a hand's force towards `wanted` (3,) [m] to a body during the next physics step.

        Stiffness [1/s^2] and damping [1/s] are per unit of mass, spin damping [1/s] is per unit of inertia.
        """
        body = self.model.body(name).id
        dof = int(self.model.body_dofadr[body])
        mass, inertia = float(self.model.body_subtreemass[body]), self.model.body_inertia[body]
        velocity, spin = np.zeros(3), np.zeros(3)
        if self.model.body_dofnum[body] == _FREE:  # what hangs on a joint is only held back by that joint
            velocity, spin = self.data.qvel[dof : dof + 3], self.data.qvel[dof + 3 : dof + 6]
        force = mass * (stiffness * (wanted - self.data.xpos[body]) - damping * velocity)
        if carries_weight:
            force = force - mass * self.model.opt.gravity
        rotation, axes = self.data.xmat[body].reshape(3, 3), self.data.ximat[body].reshape(3, 3)
        self.data.xfrc_applied[body, :3] = force  # each axis by its own inertia: a rod's is small about its length
        self.data.xfrc_applied[body, 3:] = axes @ (-spin_damping * inertia * (axes.T @ rotation @ spin))

    def let_go(self, name: str) -> None:
        """Remove the hand's force from a body."""
        self.data.xfrc_applied[self.model.body(name).id] = 0.0

    def push(self, joint: str, force_n: Array) -> None:
        """Apply a force (3,) in the world to the link of a joint, at its centre of mass, until the next push."""
        self.data.xfrc_applied[int(self.model.joint(self._prefix + joint).bodyid[0]), :3] = force_n

    def check_posture(self, q_rad: Array) -> tuple[Array, str]:
        """The arm in another posture (n_joints,) [rad], everything else in place.

        Returns:
            (3,) position of the tool centre point [m], and `part|other` of a new contact of the robot with itself,
            another robot or something fixed; empty without one.
        """
        seen = self._considered
        seen.qpos[:] = self.data.qpos
        self.write_posture(seen, q_rad)
        mujoco.mj_kinematics(self.model, seen)
        mujoco.mj_collision(self.model, seen)
        new = self._find_firm_contacts(seen)
        if new:
            new -= self._find_firm_contacts(self.data)
        names = [f"{self.model.body(first).name}|{self.model.body(second).name}" for first, second in sorted(new)]
        return np.array(seen.site_xpos[self._tcp]), names[0] if names else ""

    def _find_firm_contacts(self, data: mujoco.MjData) -> set[tuple[int, int]]:
        """Pairs of bodies: a moving part of the robot, and the robot itself, another robot or something fixed."""
        geoms = data.contact.geom[: data.ncon]
        firm = find_firm(geoms, self._kinds, _ROBOT, _LOOSE, _FINGER)
        return {(int(a), int(b)) for a, b in self.model.geom_bodyid[geoms[firm]]} if len(firm) else set()

    def find_hardest_contact(self) -> tuple[float, str]:
        """The greatest force [N] between the robot and one other body, or two parts of it, in the latest physics step.

        Forces are added as vectors: a grip, which presses from both sides, cancels out; a blow does not.

        Returns:
            The force and `part|other`; zero and empty without contact.
        """
        geoms = self.data.contact.geom[: self.data.ncon]
        forces: dict[tuple[int, int], Array] = {}
        wrench = np.zeros(6)
        for index in np.flatnonzero(self._of_robot[geoms].any(axis=1)).tolist():
            (first, second), (ours, theirs) = geoms[index], self._of_robot[geoms[index]]
            first, second = int(self.model.geom_bodyid[first]), int(self.model.geom_bodyid[second])
            mujoco.mj_contactForce(self.model, self.data, index, wrench)
            force = self.data.contact.frame[index].reshape(3, 3).T @ wrench[:3]  # of the first on the second
            key = (first, second) if ours and theirs else (-1, second if ours else first)
            forces[key] = forces.get(key, 0.0) + (force if ours else -force)
        if not forces:
            return 0.0, ""
        key, force = max(forces.items(), key=lambda item: float(np.linalg.norm(item[1])))
        part, other = ("robot" if body < 0 else self.model.body(body).name for body in key)
        return float(np.linalg.norm(force)), f"{part}|{other}"

    def place(self, data: mujoco.MjData, body: str = "") -> Array:
        """(4, 4) pose of a body, or of the tool centre point, in a state whose kinematics are computed."""
        found, T = data.body(body) if body else data.site(self._tcp), np.eye(4)
        T[:3, :3], T[:3, 3] = found.xmat.reshape(3, 3), found.xpos
        return T

    def set_pad_friction(self, friction: tuple[float, float, float] | None) -> None:
        """Friction (slide, spin, roll) of the finger pads, and of what decides over them; None for the model's."""
        self.model.geom_friction[self._gripping] = self._grip_friction if friction is None else friction
        own = self._pair_friction
        self.model.pair_friction[self._pad_pairs] = own if friction is None else np.repeat(friction, (2, 1, 2))

    def set_joint_friction(self, joint: str, torque_nm: float | None) -> None:
        """Dry friction of a joint [Nm]; None for the model's."""
        dof = int(self.model.joint(self._prefix + joint).dofadr[0])
        own = torque_nm is None
        self.model.dof_frictionloss[dof] = self._joint_friction[dof] if own else torque_nm
        self.model.dof_solimp[dof, :2] = self._joint_impedance[dof] if own else RIGID  # a soft friction would creep


def advance(robots: Collection[Physics], count: int) -> None:
    """Advance a scene by `count` physics steps, in which the bases of its robots stand or drive on."""
    scene, driven = next(iter(robots)).scene, [each for each in robots if each.base is not None]
    if not driven and count > 0:
        mujoco.mj_step(scene.model, scene.data, count)
    for _ in range(count if driven else 0):
        for each in driven:
            each.drive()
        mujoco.mj_step(scene.model, scene.data)


def _as_slice(places: list[int]) -> slice | NDArray[np.intp]:
    """Places in an array; a slice where they are consecutive, since a view costs less than a copy."""
    first, count = next(iter(places), 0), len(places)
    return slice(first, first + count) if places == list(range(first, first + count)) else np.array(places)
