"""Queries on one robot in a compiled scene: poses, contacts, grips, and the ground truth of its world.

They are computed in MjData of their own and never touch the stepped state: a run with more queries has the same bits.
"""

from collections.abc import Mapping

import msgspec
import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.geometry import as_pose, make_matrix, turn
from phyagentos.protocol.world.environment import Contents, Entity, Interior, Pose, TargetState
from phyagentos.runtime.drivers.mujoco.actuation import FREE, Actuation
from phyagentos.runtime.drivers.mujoco.robot_state import Array, RobotState

_ROBOT, _LOOSE, _FINGER = 1, 2, 4  # what a geom belongs to


class Queries:
    """What can be measured of a robot and its world; `seen` holds the poses of the latest `look`."""

    def __init__(self, state: RobotState, actuation: Actuation) -> None:
        model, scene = state.model, state.scene
        self._state, self._actuation, self._model, self._data = state, actuation, model, state.data
        self.seen, self._considered = mujoco.MjData(model), mujoco.MjData(model)
        self._jacobian = np.zeros((6, model.nv))
        self._pads = actuation.pads
        self._tcp = model.site(state.prefix + state.profile.tcp).id
        self._bodies = {model.body(entity.name).id: entity for entity in scene.entities}
        self._movable = {entity.name for entity in scene.entities if entity.movable}
        self._balls = np.array([model.body(name).id for name in scene.balls], dtype=np.intp)
        self._of_robot = self._find_robot()
        loose = {body for body, entity in self._bodies.items() if entity.movable} | set(self._balls.tolist())
        is_loose = np.array([int(body) in loose for body in model.geom_bodyid])
        kinds = (_ROBOT * self._of_robot + _LOOSE * is_loose + _FINGER * self._find_fingers()).astype(np.uint8)
        of_pair = kinds[:, None] | kinds, kinds[:, None] & kinds
        self._firm = (of_pair[0] & (_ROBOT | _LOOSE) == _ROBOT) & (of_pair[1] < _FINGER)  # closed fingers touch

    def _find_robot(self) -> NDArray[np.bool_]:
        """(n_geoms,) whether a geom belongs to what the robot moves."""
        model, state = self._model, self._state
        if state.base is not None:
            bodies = state.base.list_guarded(model)
        else:
            names = (*state.profile.arm.joints[state.servoed], *state.hand.joints)
            bodies = [int(model.joint(state.prefix + name).bodyid[0]) for name in names]
        moving = {int(model.body_weldid[body]) for body in bodies}
        return np.array([int(model.body_weldid[body]) in moving for body in model.geom_bodyid])

    def _find_fingers(self) -> NDArray[np.bool_]:
        """(n_geoms,) whether a geom belongs to a finger; a jaw may stand still."""
        model, state = self._model, self._state
        bodies = [model.jnt_bodyid[model.joint(state.prefix + name).id] for name in state.hand.joints]
        bodies += [model.geom_bodyid[pad] for pad in self._pads]
        found: NDArray[np.bool_] = np.isin(
            model.body_weldid[model.geom_bodyid], [int(model.body_weldid[body]) for body in bodies]
        )
        return found

    def look(self) -> None:
        """Compute poses of the present, for the queries below; ExecutionError where there is none."""
        if not np.isfinite(self._data.qpos).all():
            raise ExecutionError("TARGET_LOST", f"the simulation became unstable before {self._state.time_s:.3f} s")
        seen = self.seen
        seen.time = self._data.time
        seen.qpos[:] = self._data.qpos
        seen.qvel[:] = self._data.qvel
        mujoco.mj_kinematics(self._model, seen)

    def find_touching(self) -> dict[str, int]:
        """Entities that touched a pad in the latest physics step, with the number of pads."""
        touched: dict[str, set[int]] = {}
        pairs, own = self._data.contact.geom[: self._data.ncon].tolist(), self._pads
        for pad, other in ((a, b) if a in own else (b, a) for a, b in pairs if a in own or b in own):
            entity = self._bodies.get(int(self._model.geom_bodyid[other]))
            if entity is not None:
                touched.setdefault(entity.name, set()).add(pad)
        return {name: len(pads) for name, pads in sorted(touched.items())}

    def read_target(self, touching: dict[str, int]) -> TargetState:
        """The arm's own state (after `look`); the pose of the tool follows from the measured joints."""
        q_rad, qd_rad_s = self._state.measure_joints()
        return TargetState(
            q_rad=tuple(q_rad.tolist()),
            qd_rad_s=tuple(qd_rad_s.tolist()),
            gripper_width_m=self._state.gripper_width_m,
            tcp=self._compute_tool(q_rad - self._state.read_joints(self._data)[0]),
            holding=tuple(n for n, pads in touching.items() if pads == len(self._pads) and n in self._movable),
            grip_force_n=self._actuation.measure_grip(),
            base=None if self._state.base is None else (float(q_rad[0]), float(q_rad[1]), float(q_rad[2])),
            trunk=None if self._state.base is None else self._read_pose(self._state.base.body),
        )

    def _compute_tool(self, error_rad: Array) -> Pose:
        """Pose of the tool centre point for joints (n_joints,) measured with a small error [rad] (after `look`)."""
        mujoco.mj_comPos(self._model, self.seen)
        mujoco.mj_jacSite(self._model, self.seen, self._jacobian[:3], self._jacobian[3:], self._tcp)
        columns = self._jacobian[:, self._state.v_address]
        if self._state.base is not None:
            columns = np.column_stack((self._state.base.compute_columns(self._jacobian, self.seen), columns))
        moved = columns @ error_rad
        return as_pose(
            rotation=turn(moved[3:]) @ self.seen.site_xmat[self._tcp].reshape(3, 3),
            position_m=self.seen.site_xpos[self._tcp] + moved[:3],
        )

    def read_entities(self, holders: Mapping[str, str]) -> tuple[Entity, ...]:
        """Ground truth of every object (after `look`); `holders` maps entities to the target that holds each."""
        return tuple(
            msgspec.structs.replace(
                entity,
                pose=self._read_pose(body),
                speed_m_s=self._find_speed(body),
                joint=self._find_opening(body),
                held_by=holders.get(entity.name),
                observed_at_s=self._state.time_s,
                contents=self._count_balls(body, entity.interior),
            )
            for body, entity in self._bodies.items()
        )

    def _read_pose(self, body: int) -> Pose:
        return Pose(tuple(self.seen.xpos[body].tolist()), tuple(self.seen.xquat[body].tolist()))

    def _count_balls(self, body: int, inside: Interior | None) -> Contents | None:
        """Balls whose middle is in the interior of a body; None for what has none, or where there are no balls."""
        if inside is None or not len(self._balls):
            return None
        local = (self.seen.xpos[self._balls] - self.seen.xpos[body]) @ self.seen.xmat[body].reshape(3, 3)
        count = int((np.abs(local - inside.center_m) <= inside.half_m).all(axis=1).sum())
        return Contents(count, count, self._state.time_s)

    def _find_speed(self, body: int) -> float:
        """Of a body's origin [m/s]; a part moves as its whole does, since it does not turn fast."""
        whole = int(self._model.body_weldid[body])
        dof = int(self._model.body_dofadr[whole])
        if self._model.body_dofnum[whole] == FREE:
            return float(np.linalg.norm(self._data.qvel[dof : dof + 3]))
        if not self._model.body_dofnum[whole]:
            return 0.0
        joint = int(self._model.dof_jntid[dof])
        hinge = self._model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        lever = np.cross(self.seen.xaxis[joint], self.seen.xpos[body] - self.seen.xanchor[joint])
        arm_m = float(np.linalg.norm(lever)) if hinge else 1.0
        return abs(float(self._data.qvel[dof])) * arm_m

    def _find_opening(self, body: int) -> float | None:
        """Fraction of its own joint's travel; None for what has none."""
        joint = int(self._model.body_jntadr[body])
        if joint < 0 or self._model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            return None
        low, high = self._model.jnt_range[joint]
        return float(np.clip((self._data.qpos[self._model.jnt_qposadr[joint]] - low) / (high - low), 0.0, 1.0))

    def find_position(self, name: str) -> Array:
        """(3,) of a body's frame in the world, as of the latest physics step."""
        return np.array(self._data.xpos[self._model.body(name).id])

    def find_tcp(self) -> tuple[Array, Array]:
        """(3,) position and (3, 3) rotation of the tool centre point, as of the latest physics step."""
        return np.array(self._data.site_xpos[self._tcp]), np.array(self._data.site_xmat[self._tcp]).reshape(3, 3)

    def is_held(self, name: str) -> bool:
        """Whether every pad touched the entity in the latest physics step."""
        return self.find_touching().get(name) == len(self._pads)

    def find_clearance(self, point: Array, own: Array) -> float:
        """Horizontal distance from a point to the nearest movable object that is not the one at `own` [m]."""
        others = [np.array(self._data.xpos[body]) for body, entity in self._bodies.items() if entity.movable]
        distances = [np.linalg.norm((point - other)[:2]) for other in others if np.linalg.norm(own - other) > 1e-6]
        return float(min(distances, default=1.0))

    def can_grasp_at(self, point: Array) -> bool:
        """Whether a point (3,) is in the band around the base in which the arm grasps."""
        nearest_m, farthest_m = self._state.profile.grasp_band_m
        base_m = (
            self._state.profile.mount_position_m if self._state.base is None else self._data.xpos[self._state.base.body]
        )
        away_m = np.linalg.norm(point[:2] - np.array(base_m[:2]))
        return bool(nearest_m <= away_m <= farthest_m)

    def check_posture(self, q_rad: Array) -> tuple[Array, str]:
        """The arm in another posture (n_joints,) [rad], everything else in place.

        Returns:
            (3,) position of the tool centre point [m], and `part|other` of a new contact of the robot with itself,
            another robot or something fixed; empty without one.
        """
        seen = self._considered
        seen.qpos[:] = self._data.qpos
        self._state.write_posture(seen, q_rad)
        mujoco.mj_kinematics(self._model, seen)
        mujoco.mj_collision(self._model, seen)
        new = self._find_firm_contacts(seen)
        if new:
            new -= self._find_firm_contacts(self._data)
        names = [f"{self._model.body(first).name}|{self._model.body(second).name}" for first, second in sorted(new)]
        return np.array(seen.site_xpos[self._tcp]), names[0] if names else ""

    def _find_firm_contacts(self, data: mujoco.MjData) -> set[tuple[int, int]]:
        """Pairs of bodies: a moving part of the robot, and the robot itself, another robot or something fixed."""
        geoms = data.contact.geom[: data.ncon]
        firm = geoms[self._firm[geoms[:, 0], geoms[:, 1]]]
        return set(map(tuple, self._model.geom_bodyid[firm].tolist())) if len(firm) else set()

    def find_hardest_contact(self) -> tuple[float, str]:
        """The greatest force [N] between the robot and one other body, or two parts of it, in the latest physics step.

        Forces are added as vectors: a grip, which presses from both sides, cancels out; a blow does not.

        Returns:
            The force and `part|other`; zero and empty without contact.
        """
        geoms = self._data.contact.geom[: self._data.ncon]
        forces: dict[tuple[int, int], Array] = {}
        wrench = np.zeros(6)
        for index in np.flatnonzero(self._of_robot[geoms].any(axis=1)).tolist():
            (first, second), (ours, theirs) = geoms[index], self._of_robot[geoms[index]]
            first, second = int(self._model.geom_bodyid[first]), int(self._model.geom_bodyid[second])
            mujoco.mj_contactForce(self._model, self._data, index, wrench)
            force = self._data.contact.frame[index].reshape(3, 3).T @ wrench[:3]  # of the first on the second
            key = (first, second) if ours and theirs else (-1, second if ours else first)
            forces[key] = forces.get(key, 0.0) + (force if ours else -force)
        if not forces:
            return 0.0, ""
        key, force = max(forces.items(), key=lambda item: float(np.linalg.norm(item[1])))
        part, other = ("robot" if body < 0 else self._model.body(body).name for body in key)
        return float(np.linalg.norm(force)), f"{part}|{other}"

    def place(self, data: mujoco.MjData, body: str = "") -> Array:
        """(4, 4) pose of a body, or of the tool centre point, in a state whose kinematics are computed."""
        found = data.body(body) if body else data.site(self._tcp)
        return make_matrix(found.xmat.reshape(3, 3), found.xpos)
