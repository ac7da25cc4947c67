"""A body on legs: where its feet are, and which torques of its legs give it a wanted wrench from the ground.

The state is copied into a second MjData before anything is computed, so that a restored state gives the same torques.
Position and velocity of the body are those of the simulation, as an estimator without error would give them.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError
from phyagentos.geometry import UP
from phyagentos.protocol.capabilities.targets import Base
from phyagentos.runtime.drivers.mujoco.planar_base import PlanarBase

Array = NDArray[np.float64]
FRICTION = 0.4  # that is relied on: rubber has 0.45 to 0.6 (`friction.FRICTION`)
EFFORT = 1e-2  # weight of small forces against the wanted wrench, where several sharings give it
LEVER_M = 0.2  # at which a moment counts as much as a force: about half of what feet stand apart
_EDGES = np.array([[FRICTION, 0, 1], [-FRICTION, 0, 1], [0, FRICTION, 1], [0, -FRICTION, 1]])  # of a friction pyramid


class Legs:
    """The body of a robot on a free joint, and its legs; `look` comes before every query.

    Attributes:
        home_rad: (n,) posture of the legs in which it stands.
        home_feet_m: (n_feet, 3) soles then, from the frame of the upright body.
        height_m: Of that frame above the ground then.
    """

    def __init__(self, model: mujoco.MjModel, planar: PlanarBase, base: Base, n_feet: int) -> None:
        """Feet are the bodies of the base's joints that have solid spheres, in the order of the joints.

        Raises:
            DefinitionError: `INVALID_VALUE` when there are more or fewer feet.
        """
        self.model, self._planar, self._seen = model, planar, mujoco.MjData(model)
        spheres = (_find_spheres(model, int(model.jnt_bodyid[joint])) for joint in planar.joints)
        self._contacts = [found for found in spheres if len(found)]
        if len(self._contacts) != n_feet:
            found = f"{len(self._contacts)} bodies with solid spheres"
            raise DefinitionError.of(
                "INVALID_VALUE", f"base.joints of kind {base.kind!r}", found, f"{n_feet}, its feet"
            )
        self._mass_kg = float(model.body_subtreemass[planar.body])
        self.weight_n = self._mass_kg * float(-model.opt.gravity[2])
        self.home_rad = planar.rest
        planar.place(self._seen, np.zeros(3))
        mujoco.mj_kinematics(model, self._seen)
        self.home_feet_m = np.array([self.find_foot(foot) for foot in range(n_feet)]) - self.position_m
        self.height_m = -float(self.home_feet_m[:, 2].min())

    def look(self, data: mujoco.MjData) -> None:
        """Take a state, for all that follows."""
        seen = self._seen
        seen.qpos[:], seen.qvel[:] = data.qpos, data.qvel
        mujoco.mj_kinematics(self.model, seen)
        mujoco.mj_comPos(self.model, seen)
        mujoco.mj_comVel(self.model, seen)
        mujoco.mj_rne(self.model, seen, 0, seen.qfrc_bias)
        mujoco.mj_passive(self.model, seen)

    @property
    def position_m(self) -> Array:
        """(3,) of the body's frame."""
        return np.array(self._seen.xpos[self._planar.body])

    @property
    def velocity_m_s(self) -> Array:
        """(3,) of the body's frame, in the world."""
        return np.array(self._seen.qvel[self._planar.free_v : self._planar.free_v + 3])

    @property
    def rotation(self) -> Array:
        """(3, 3) `world_R_body`."""
        return np.array(self._seen.xmat[self._planar.body]).reshape(3, 3)

    @property
    def yaw_rad(self) -> float:
        """Heading of the body's x axis."""
        return float(np.arctan2(self.rotation[1, 0], self.rotation[0, 0]))

    @property
    def lean(self) -> Array:
        """(3,) turn that would bring the body upright, level: an axis in the world by the sine of the angle."""
        x, y, _ = self.rotation[:, 2]
        return np.array((y, -x, 0.0))

    @property
    def spin_rad_s(self) -> Array:
        """(3,) angular velocity, in the world."""
        return np.array(self.rotation @ self._seen.qvel[self._planar.free_v + 3 : self._planar.free_v + 6])

    @property
    def center_m(self) -> Array:
        """(3,) centre of mass."""
        return np.array(self._seen.subtree_com[self._planar.body])

    @property
    def q_rad(self) -> Array:
        """(n,) of the legs."""
        return np.array(self._seen.qpos[self._planar.q_address])

    @property
    def qd_rad_s(self) -> Array:
        """(n,) of the legs."""
        return np.array(self._seen.qvel[self._planar.v_address])

    def find_center_velocity(self) -> Array:
        """(3,) of the centre of mass."""
        J = np.zeros((3, self.model.nv))
        mujoco.mj_jacSubtreeCom(self.model, self._seen, J, self._planar.body)
        return np.array(J @ self._seen.qvel)

    def find_inertia(self) -> Array:
        """(3, 3) of the whole about its centre of mass, in the world, in the present posture."""
        M = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_crb(self.model, self._seen)
        mujoco.mj_fullM(self.model, self._seen, M)
        turning = slice(self._planar.free_v + 3, self._planar.free_v + 6)
        r = self.center_m - self.position_m
        about_body = self.rotation @ M[turning, turning] @ self.rotation.T
        return np.array(about_body - self._mass_kg * (r @ r * np.eye(3) - np.outer(r, r)))

    def find_foot(self, foot: int) -> Array:
        """(3,) the middle of a foot's points of contact."""
        points = self._find_points(self._contacts[foot])
        return np.array(points.sum(axis=0) / len(points))

    def find_foot_velocity(self, foot: int) -> Array:
        """(3,) of that middle."""
        J, body = np.zeros((3, self.model.nv)), self.model.geom_bodyid[self._contacts[foot][0]]
        mujoco.mj_jac(self.model, self._seen, J, None, self.find_foot(foot), body)
        return np.array(J @ self._seen.qvel)

    def carry(self) -> Array:
        """(n,) torques of the legs against their own weight and swing, and what damps their joints."""
        return np.array((self._seen.qfrc_bias - self._seen.qfrc_passive)[self._planar.v_address])

    def push(self, foot: int, force_n: Array) -> Array:
        """(n,) torques of the legs by which a foot exerts a force (3,) on the world, its own weight apart."""
        return self._exert(self._contacts[foot][:1], self.find_foot(foot)[None], force_n[None])

    def stand_on(self, feet: Sequence[int], acceleration_m_s2: Array, angular_rad_s2: Array) -> Array:
        """(n,) torques that give the centre of mass, and the body about it, accelerations as near as the ground can."""
        geoms = np.concatenate([self._contacts[foot] for foot in feet])
        points = self._find_points(geoms)
        return -self._exert(
            geoms,
            points,
            share_wrench(
                points - self.center_m,
                force_n=self._mass_kg * (acceleration_m_s2 - self.model.opt.gravity),
                moment_nm=self.find_inertia() @ angular_rad_s2,
                weight_n=self.weight_n,
            ),
        )

    def command(self, data: mujoco.MjData, torque_nm: Array) -> None:
        """Write torques (n,) of the legs, within the motors' limits."""
        low, high = self.model.actuator_forcerange[self._planar.motors].T
        data.ctrl[self._planar.motors] = np.clip(torque_nm, low, high)

    def _find_points(self, geoms: NDArray[np.intp]) -> Array:
        """(k, 3) the lowest points of spheres."""
        return np.array(self._seen.geom_xpos[geoms] - self.model.geom_size[geoms, :1] * UP)

    def _exert(self, geoms: NDArray[np.intp], points: Array, forces_n: Array) -> Array:
        """(n,) torques J^T f of the legs for forces (k, 3) at points (k, 3) of the bodies of geoms (k,)."""
        torque, none = np.zeros(self.model.nv), np.zeros(3)
        for body, point, force in zip(self.model.geom_bodyid[geoms], points, forces_n, strict=True):
            mujoco.mj_applyFT(self.model, self._seen, force, none, point, body, torque)
        return np.array(torque[self._planar.v_address])


def share_wrench(levers_m: Array, force_n: Array, moment_nm: Array, weight_n: float) -> Array:
    """(k, 3) forces at points, within their friction pyramids, whose sum is nearest to a wrench.

    Least squares with non-negative shares of the pyramids' edges (Lawson and Hanson); `levers_m` (k, 3) are the points
    from where the moment is taken, and `weight_n` is the unit in which forces are compared.
    """
    from scipy.optimize import nnls  # a third of a second, for legs alone

    k, edges = len(levers_m), len(_EDGES)
    rays = np.tile(_EDGES, (k, 1))
    A = np.empty((6, k * edges))
    A[:3] = rays.T
    A[3:] = np.cross(np.repeat(levers_m, edges, axis=0), rays).T / LEVER_M
    b = np.concatenate((force_n, moment_nm / LEVER_M)) / weight_n
    shares, _ = nnls(np.vstack((A, EFFORT * np.eye(k * edges))), np.concatenate((b, np.zeros(k * edges))))
    return np.array((shares[:, None] * rays).reshape(k, edges, 3).sum(axis=1) * weight_n)


def _find_spheres(model: mujoco.MjModel, body: int) -> NDArray[np.intp]:
    start, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    found = [g for g in range(start, start + count) if model.geom_type[g] == sphere and model.geom_contype[g]]
    return np.array(found, dtype=np.intp)
