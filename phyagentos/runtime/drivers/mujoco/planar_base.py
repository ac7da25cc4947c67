"""Where a free base stands in the simulation: its planar pose and speed, and its motors."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_rotation, multiply
from phyagentos.protocol.capabilities.targets import BASE_JOINTS, TargetProfile
from phyagentos.runtime.models.base import FREE_JOINT

Array = NDArray[np.float64]


class PlanarBase:
    """The base of a target in a compiled scene; `prefix` is of the target's names in the model.

    Attributes:
        body: Its id; its frame is that of the free joint.
        joints: (k,) ids of what it drives; `motors` (k,) are their actuators, `q_address` and `v_address` (k,) where
            their positions and velocities are.
        speed_max: (3,) of x, y [m/s] and yaw [rad/s].
        q_min, q_max: (3,) of x, y [m] and yaw [rad].
        free_q, free_v: Where the free joint's state begins.
        rest: (k,) positions of the joints at rest.
    """

    def __init__(self, model: mujoco.MjModel, profile: TargetProfile, prefix: str) -> None:
        base = profile.base
        if base is None:
            raise ValueError(f"{profile.target} has no base")
        free = model.joint(prefix + FREE_JOINT)
        self.body, self.free_q, self.free_v = int(free.bodyid[0]), int(free.qposadr[0]), int(free.dofadr[0])
        joints = [model.joint(prefix + name) for name in base.joints]
        self.joints = np.array([joint.id for joint in joints], dtype=np.intp)
        self.q_address = np.array([int(joint.qposadr[0]) for joint in joints], dtype=np.intp)
        self.v_address = np.array([int(joint.dofadr[0]) for joint in joints], dtype=np.intp)
        self.motors = np.array([model.actuator(f"{prefix}act_{name}").id for name in base.joints], dtype=np.intp)
        posture = dict(base.posture_rad)
        self.rest = np.array([posture.get(name, 0.0) for name in base.joints])
        self.speed_max = np.array(profile.arm.velocity_rad_s[: len(BASE_JOINTS)])
        self.q_min, self.q_max = np.array(base.pose_min), np.array(base.pose_max)
        self._height_m, self._upright = profile.mount_position_m[2], profile.mount_quaternion_wxyz
        self._back = compute_rotation(self._upright).T

    def read_pose(self, data: mujoco.MjData) -> Array:
        """(3,) x, y [m] and heading [rad] in the world."""
        x, y, _, *turned = data.qpos[self.free_q : self.free_q + 7]
        R = compute_rotation(turned) @ self._back
        return np.array((x, y, np.arctan2(R[1, 0], R[0, 0])))

    def read_rate(self, data: mujoco.MjData) -> Array:
        """(3,) speeds in the world [m/s, m/s, rad/s]."""
        vx, vy, _, *spin = data.qvel[self.free_v : self.free_v + 6]
        return np.array((vx, vy, self.find_up(data) @ spin))

    def find_up(self, data: mujoco.MjData) -> Array:
        """(3,) the world's upward direction in the frame of the body, in which the free joint's spin is."""
        start = self.free_q + 3
        up: Array = compute_rotation(data.qpos[start : start + 4])[2]
        return up

    def write_pose(self, data: mujoco.MjData, pose: Array) -> None:
        """Put it at a pose (3,), level or tilted as it is, at its height."""
        turned = float(pose[2] - self.read_pose(data)[2])
        start = self.free_q + 3
        about_z = (float(np.cos(turned / 2)), 0.0, 0.0, float(np.sin(turned / 2)))
        data.qpos[self.free_q : self.free_q + 2] = pose[:2]
        data.qpos[start : start + 4] = multiply(about_z, data.qpos[start : start + 4])

    def place(self, data: mujoco.MjData, pose: Array) -> None:
        """Let it stand at a pose (3,) at rest, before time begins."""
        data.qpos[self.free_q + 2] = self._height_m
        data.qpos[self.free_q + 3 : self.free_q + 7] = self._upright
        data.qpos[self.q_address] = self.rest
        self.write_pose(data, pose)

    def compute_columns(self, jacobian: Array, data: mujoco.MjData) -> Array:
        """(6, 3) of a Jacobian (6, nv): by x, y and heading."""
        start = self.free_v
        return np.column_stack(
            (jacobian[:, start : start + 2], jacobian[:, start + 3 : start + 6] @ self.find_up(data))
        )

    def list_guarded(self, model: mujoco.MjModel) -> list[int]:
        """Bodies of the robot but for wheels or legs, which are there to touch the ground."""
        gear = set(model.jnt_bodyid[self.joints].tolist())
        for body in range(model.nbody):  # parents come first
            gear |= {body} if int(model.body_parentid[body]) in gear else set()
        return [body for body in np.flatnonzero(model.body_rootid == self.body).tolist() if body not in gear]
