"""A free body that stands on feet: where they are, and which motor torques give it a wanted wrench from the ground.

The state is copied into a second MjData before anything is computed, so that a restored state gives the same torques.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]
FRICTION = 0.5  # that is relied on, below that of most floors
EFFORT = 1e-2  # weight of small forces against the wanted wrench
_EDGES = np.array([[FRICTION, 0, 1], [-FRICTION, 0, 1], [0, FRICTION, 1], [0, -FRICTION, 1]])  # of a friction pyramid
_LEVER_M = 0.2  # at which a moment counts as much as a force


@dataclass(frozen=True, slots=True)
class Contact:
    """A sphere of a foot that can touch the ground."""

    body: int
    geom: int
    radius_m: float


class FeetOnGround:
    """The body of a robot on a free joint, its feet, and the motors of its legs."""

    def __init__(
        self, model: mujoco.MjModel, body: str, joints: Sequence[str], feet: Sequence[str], motors: Sequence[str]
    ) -> None:
        """`feet` are bodies; each sphere among their geoms that collides is a point of contact."""
        self.model, self._seen = model, mujoco.MjData(model)
        self.root = model.body(body).id
        free = int(model.body_jntadr[self.root])
        self._q, self._v = int(model.jnt_qposadr[free]), int(model.jnt_dofadr[free])
        self.q_address = np.array([model.joint(name).qposadr[0] for name in joints])
        self.v_address = np.array([model.joint(name).dofadr[0] for name in joints])
        self.motors = np.array([model.actuator(name).id for name in motors])
        self.contacts = [
            [Contact(model.body(foot).id, geom, float(model.geom_size[geom, 0])) for geom in _find_spheres(model, foot)]
            for foot in feet
        ]
        self.mass_kg = float(model.body_subtreemass[self.root])
        self.weight_n = self.mass_kg * float(-model.opt.gravity[2])

    def look(self, data: mujoco.MjData) -> None:
        """Take a state, for all that follows."""
        seen = self._seen
        seen.qpos[:], seen.qvel[:] = data.qpos, data.qvel
        mujoco.mj_kinematics(self.model, seen)
        mujoco.mj_comPos(self.model, seen)
        mujoco.mj_comVel(self.model, seen)
        mujoco.mj_rne(self.model, seen, 0, seen.qfrc_bias)

    @property
    def position_m(self) -> Array:
        """(3,) of the body's frame."""
        return self._seen.qpos[self._q : self._q + 3]

    @property
    def velocity_m_s(self) -> Array:
        """(3,) in the world."""
        return self._seen.qvel[self._v : self._v + 3]

    @property
    def rotation(self) -> Array:
        """(3, 3) `world_R_body`."""
        return self._seen.xmat[self.root].reshape(3, 3)

    @property
    def yaw_rad(self) -> float:
        """Heading of the body's x axis."""
        return float(np.arctan2(self.rotation[1, 0], self.rotation[0, 0]))

    @property
    def spin_rad_s(self) -> Array:
        """(3,) angular velocity in the world."""
        return self.rotation @ self._seen.qvel[self._v + 3 : self._v + 6]

    @property
    def center_m(self) -> Array:
        """(3,) centre of mass."""
        return self._seen.subtree_com[self.root]

    @property
    def q_rad(self) -> Array:
        """(n,) of the legs."""
        return self._seen.qpos[self.q_address]

    @property
    def qd_rad_s(self) -> Array:
        """(n,) of the legs."""
        return self._seen.qvel[self.v_address]

    def find_center_velocity(self) -> Array:
        """(3,) of the centre of mass."""
        J = np.zeros((3, self.model.nv))
        mujoco.mj_jacSubtreeCom(self.model, self._seen, J, self.root)
        return J @ self._seen.qvel

    def find_inertia(self) -> Array:
        """(3, 3) of the whole about its centre of mass, in the world, in the present posture."""
        mujoco.mj_crb(self.model, self._seen)
        M = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self._seen, M)
        about_body = self.rotation @ M[self._v + 3 : self._v + 6, self._v + 3 : self._v + 6] @ self.rotation.T
        r = self.center_m - self.position_m
        return about_body - self.mass_kg * (r @ r * np.eye(3) - np.outer(r, r))

    def find_foot(self, foot: int) -> Array:
        """(3,) the middle of a foot's points of contact."""
        return np.mean([self._find_point(each) for each in self.contacts[foot]], axis=0)

    def find_foot_jacobian(self, foot: int) -> Array:
        """(3, nv) of that middle."""
        return self._find_jacobian(self.contacts[foot][0].body, self.find_foot(foot))

    def find_foot_velocity(self, foot: int) -> Array:
        """(3,) of that middle."""
        return self.find_foot_jacobian(foot) @ self._seen.qvel

    def push(self, foot: int, force_n: Array) -> Array:
        """(n,) torques of the legs with which a foot exerts a force (3,) on the world, its own weight apart."""
        return self.find_foot_jacobian(foot)[:, self.v_address].T @ force_n

    def carry(self) -> Array:
        """(n,) torques of the legs against their own weight and swing."""
        return self._seen.qfrc_bias[self.v_address]

    def stand_on(self, feet: Sequence[int], force_n: Array, moment_nm: Array) -> Array:
        """(n,) torques of the legs that give the body a wrench about its centre of mass, as near as the ground can."""
        contacts = [each for foot in feet for each in self.contacts[foot]]
        points = np.array([self._find_point(each) for each in contacts])
        forces = share_wrench(points - self.center_m, force_n, moment_nm, self.weight_n)
        torque = np.zeros(len(self.v_address))
        for each, point, force in zip(contacts, points, forces, strict=True):
            torque -= self._find_jacobian(each.body, point)[:, self.v_address].T @ force
        return torque

    def command(self, data: mujoco.MjData, torque_nm: Array) -> None:
        """Write torques of the legs, within the motors' limits."""
        low, high = self.model.actuator_ctrlrange[self.motors].T
        data.ctrl[self.motors] = np.clip(torque_nm, low, high)

    def _find_point(self, contact: Contact) -> Array:
        return self._seen.geom_xpos[contact.geom] - (0.0, 0.0, contact.radius_m)

    def _find_jacobian(self, body: int, point: Array) -> Array:
        J = np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self._seen, J, None, point, body)
        return J


def share_wrench(levers_m: Array, force_n: Array, moment_nm: Array, weight_n: float) -> Array:
    """(k, 3) forces at points, within their friction pyramids, whose sum is nearest to a wrench.

    Least squares with non-negative shares of the pyramids' edges (Lawson and Hanson); `levers_m` (k, 3) are the points
    from where the moment is taken.
    """
    k, edges = len(levers_m), len(_EDGES)
    rays = np.tile(_EDGES, (k, 1))
    A = np.empty((6, k * edges))
    A[:3] = rays.T
    A[3:] = np.cross(np.repeat(levers_m, edges, axis=0), rays).T / _LEVER_M
    b = np.concatenate((force_n, moment_nm / _LEVER_M)) / weight_n
    shares, _ = nnls(np.vstack((A, EFFORT * np.eye(k * edges))), np.concatenate((b, np.zeros(k * edges))))
    return (shares[:, None] * rays).reshape(k, edges, 3).sum(axis=1) * weight_n


def _find_spheres(model: mujoco.MjModel, body: str) -> list[int]:
    start, count = int(model.body(body).geomadr[0]), int(model.body(body).geomnum[0])
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    return [g for g in range(start, start + count) if model.geom_type[g] == sphere and model.geom_contype[g]]
