"""One state of a compiled MuJoCo model: where bodies are, how fast they move, and what touches them with what force."""

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GEOM = mujoco.mjtGeom
FREE = mujoco.mjtJoint.mjJNT_FREE


def read_state(path: Path) -> Array:
    """The state vector (mjSTATE_INTEGRATION) of `initial.npz` or `terminal.npz`."""
    with np.load(path) as stored:
        return np.asarray(stored["state"])


def read_time(path: Path) -> float:
    """Simulated time of such a file [s]."""
    with np.load(path) as stored:
        return float(stored["time"])


def read_model(bundle: Path) -> mujoco.MjModel:
    """The world of an evidence bundle."""
    return mujoco.MjModel.from_binary_path(str(bundle / "scene.mjb"))


class Moment:
    """A model in a state, with all that follows from it.

    Args:
        model: Compiled.
        state: State vector (mjSTATE_INTEGRATION).
    """

    def __init__(self, model: mujoco.MjModel, state: Array) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        mujoco.mj_setState(model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(model, self.data)

    @classmethod
    def read(cls, bundle: Path, at: str = "terminal") -> "Moment":
        """The end of a recorded session, or its beginning with `initial`."""
        return cls(read_model(bundle), read_state(bundle / f"{at}.npz"))

    def find(self, name: str) -> int:
        """Number of a body; raises ValueError where there is none."""
        found = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
        if found < 0:
            raise ValueError(f"the recorded world has no {name!r}")
        return int(found)

    def list_free(self) -> list[str]:
        """Names of the bodies that move freely."""
        model = self.model
        joints = ((model.body(body).name, model.body_jntadr[body]) for body in range(model.nbody))
        return sorted(name for name, joint in joints if name and joint >= 0 and model.jnt_type[joint] == FREE)

    def locate(self, name: str) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) of a body."""
        seen = self.data.body(self.find(name))
        return seen.xmat.reshape(3, 3).copy(), seen.xpos.copy()

    def find_local(self, name: str, frame: str) -> Array:
        """(3,) origin of a body in the frame of another one."""
        turn, at = self.locate(frame)
        return np.asarray(turn.T @ (self.locate(name)[1] - at))

    def measure_speed(self, name: str) -> float:
        """Of a body's origin [m/s]."""
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, self.find(name), velocity, 0)
        return float(np.linalg.norm(velocity[3:]))

    def measure_opening(self, name: str) -> tuple[float, float]:
        """Share of its travel by which the joint of a body is open, and that travel [m or rad]."""
        joint = self.model.joint(int(self.model.body_jntadr[self.find(name)]))
        low, high = joint.range
        return float((self.data.qpos[joint.qposadr[0]] - low) / (high - low)), float(high - low)

    # -- contacts ------------------------------------------------------------------------------------------------------

    def list_touching(self) -> list[frozenset[int]]:
        """The two bodies of each contact."""
        pairs = self.model.geom_bodyid[self.data.contact.geom[: self.data.ncon]]
        return [frozenset(pair) for pair in pairs.tolist()]

    def find_touching(self, name: str) -> set[int]:
        """Numbers of the bodies that touch one."""
        own = self.find(name)
        return {body for pair in self.list_touching() if own in pair for body in pair - {own}}

    def sum_force(self, name: str, other: str) -> Array:
        """(3,) sum of the forces [N] with which another body acts on this one."""
        ours, both, total, wrench = self.find(name), {self.find(name), self.find(other)}, np.zeros(3), np.zeros(6)
        for index, pair in enumerate(self.list_touching()):
            if pair == both:
                contact = self.data.contact[index]
                mujoco.mj_contactForce(self.model, self.data, index, wrench)
                along = contact.frame.reshape(3, 3).T @ wrench[:3]
                total += along if self.model.geom_bodyid[contact.geom[1]] == ours else -along
        return total

    # -- solids --------------------------------------------------------------------------------------------------------

    def list_solids(self, name: str) -> list[int]:
        """Geometries of a body that touch others."""
        model = self.model
        geoms = np.flatnonzero(model.geom_bodyid == self.find(name))
        return [int(geom) for geom in geoms if model.geom_contype[geom] or model.geom_conaffinity[geom]]

    def find_half(self, geom: int) -> Array:
        """(3,) half extents of the box around a solid, in its own frame."""
        a, b, c = self.model.geom_size[geom]
        halves = {GEOM.mjGEOM_BOX: (a, b, c), GEOM.mjGEOM_SPHERE: (a, a, a), GEOM.mjGEOM_CAPSULE: (a, a, a + b)}
        return np.array(halves.get(GEOM(self.model.geom_type[geom]), (a, a, b)))

    def find_middle(self, name: str) -> Array:
        """(3,) middle of the box around a body, taken in its own frame."""
        (turn, origin), ends = self.locate(name), []
        for geom in self.list_solids(name):
            own = turn.T @ self.data.geom_xmat[geom].reshape(3, 3)
            at = turn.T @ (self.data.geom_xpos[geom] - origin)
            reach = self._supports(geom, own.T)
            ends += [at + reach, at - reach]
        return np.asarray(turn @ ((np.max(ends, axis=0) + np.min(ends, axis=0)) / 2) + origin)

    def measure_reach(self, name: str, direction: Array) -> float:
        """Greatest coordinate of a body along a direction (3,) of the world."""
        found = []
        for geom in self.list_solids(name):
            own = self.data.geom_xmat[geom].reshape(3, 3).T @ direction
            found.append(float(direction @ self.data.geom_xpos[geom] + self._supports(geom, own[:, None])[0]))
        return max(found)

    def find_lowest(self, name: str) -> float:
        """Height of its lowest point [m]."""
        return -self.measure_reach(name, np.array([0.0, 0.0, -1.0]))

    def measure_room(self, name: str, point: Array) -> float:
        """How far a point is within the edge of a body seen from above [m]; a disc, or a box along the world's axes."""
        solids = self.list_solids(name)
        if len(solids) == 1 and self.model.geom_type[solids[0]] == GEOM.mjGEOM_CYLINDER:
            away = point[:2] - self.data.geom_xpos[solids[0]][:2]
            return float(self.model.geom_size[solids[0]][0] - np.hypot(*away))
        sides = np.array([(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)])
        return min(self.measure_reach(name, side) - float(side @ point) for side in sides)

    def _supports(self, geom: int, directions: Array) -> Array:
        """(n,) how far a solid reaches from its middle along the columns of (3, n) directions of its own frame."""
        a, b, _ = self.model.geom_size[geom]
        flat, axial = np.hypot(directions[0], directions[1]), abs(directions[2])
        match GEOM(self.model.geom_type[geom]):
            case GEOM.mjGEOM_BOX:
                return np.asarray(abs(directions).T @ self.find_half(geom))
            case GEOM.mjGEOM_SPHERE:
                return np.full(directions.shape[1], a)
            case GEOM.mjGEOM_CAPSULE:
                return np.asarray(a + axial * b)
        return np.asarray(flat * a + axial * b)
