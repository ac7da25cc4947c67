"""Several robots in one world: contacts between them, and the motions that they announce.

A motion is admitted when each of its postures keeps its distance from where every other robot stands, and from every
posture that the other has announced and not yet passed. So none is met wherever it stops on its way. Queries are
computed on a copy of the model and never touch the stepped state.
"""

from collections.abc import Collection, Mapping
from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_inverse, compute_pose
from phyagentos.runtime.drivers.mujoco.actuation import FREE
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.robot_state import Array

CLEARANCE_M = 0.03  # between two robots; postures are compared so densely that half of it lies between two of them
BESIDE_M = 0.004  # where one comes near the other on purpose: as much as planning keeps from what stands fixed
SAMPLE_RAD = 0.05  # largest turn of a joint between two postures that are compared
SLID = 2.0  # radians that a metre of a base's way counts, since all of the robot goes it
ARRIVAL_S = 0.1  # after the end of a motion, until the robot rests
NEARER_M = 0.001  # than at its beginning: a motion that begins too near another robot comes no nearer


@dataclass(frozen=True, slots=True)
class Announced:
    """An admitted motion: postures (n, n_joints), one for each physics step from `began_s` [s] on."""

    began_s: float
    q_rad: Array


@dataclass(frozen=True, slots=True)
class _Place:
    """A robot in one posture, with what it holds: joint positions by address, solids, and their middles (g, 3) [m]."""

    values: Mapping[int, float]
    geoms: NDArray[np.intp]
    centers_m: Array


class InterRobotCollisions:
    """The robots of one episode, by name."""

    def __init__(self, robots: Mapping[str, Physics]) -> None:
        self._robots = robots
        first = next(iter(robots.values()))
        self._stepped, self._world = first.model, first.data
        model = copy(first.model)
        self._model, self._data, self._names = model, mujoco.MjData(model), list(robots)
        bodies = [model.body(body).name for body in range(model.nbody)]
        of_body = np.array([self._find_owner(body) for body in bodies])
        self._owner = of_body[model.geom_bodyid]  # of each geom; -1 for objects
        model.geom_margin[self._owner >= 0] = CLEARANCE_M
        model.body_margin[of_body >= 0] = CLEARANCE_M
        self._announced: dict[str, Announced] = {}
        self._touched_n: dict[str, dict[str, float]] = {name: {} for name in robots}

    def _find_owner(self, body: str) -> int:
        return next((i for i, name in enumerate(self._names) if body.startswith(f"{name}/")), -1)

    def note(self) -> None:
        """After a physics step: note contacts between two robots, with their force."""
        owners = self._owner[self._world.contact.geom]
        for index in np.flatnonzero((owners.min(axis=1) >= 0) & (owners[:, 0] != owners[:, 1])).tolist():
            wrench = np.zeros(6)
            mujoco.mj_contactForce(self._stepped, self._world, index, wrench)
            force_n = float(np.linalg.norm(wrench[:3]))
            first, second = (self._names[owner] for owner in owners[index])
            for name, other in ((first, second), (second, first)):
                self._touched_n[name][other] = max(self._touched_n[name].get(other, 0.0), force_n)

    def take_touched(self, name: str) -> dict[str, float]:
        """Robots that a robot touched since the last call, with the greatest force of one contact [N]."""
        taken, self._touched_n[name] = self._touched_n[name], {}
        return taken

    def withdraw(self, name: str) -> None:
        """A robot rests, or moves otherwise than announced."""
        self._announced.pop(name, None)

    def find_announced(self, name: str) -> Array:
        """(k, n_joints) postures of what is left of the motion that a robot has announced; none at rest."""
        robot, motion = self._robots[name], self._announced.get(name)
        passed = 0 if motion is None else int((robot.time_s - motion.began_s) / self._model.opt.timestep)
        if motion is None or passed > len(motion.q_rad) + ARRIVAL_S / self._model.opt.timestep:
            return np.empty((0, len(robot.state.q_range[0])))
        return self._sample(name, motion.q_rad[min(passed, len(motion.q_rad) - 1) :])

    def _sample(self, name: str, q_rad: Array) -> Array:
        return sample(q_rad, slides=0 if self._robots[name].state.base is None else 2)

    def admit(self, name: str, q_rad: Array, beside: str, held: Mapping[str, Collection[str]]) -> str:
        """Admit a motion (n, n_joints) from now on; the robot that is in its way, empty when it is admitted.

        `beside` is a robot to which it comes near on purpose; `held` are the objects that each robot holds.
        """
        own = self._place(name, self._sample(name, q_rad), held[name])
        for other in (each for each in self._names if each != name):
            here, objects = (
                self._robots[other].state.read_joints(self._world)[0],
                () if other == beside else held[other],
            )
            theirs = self._place(other, np.vstack((here, self.find_announced(other))), objects)
            apart_m = BESIDE_M if other == beside else CLEARANCE_M
            apart_m = min(apart_m, self._measure(own[:1], theirs[:1]) - NEARER_M)
            if self._measure(own, theirs, enough_m=apart_m) < apart_m:
                return other
        self._announced[name] = Announced(self._robots[name].time_s, q_rad)
        return ""

    def _place(self, name: str, postures: Array, held: Collection[str]) -> list[_Place]:
        """A robot in each posture (k, n_joints), with what it holds."""
        robot, model, data = self._robots[name], self._model, self._data
        data.qpos[:] = self._world.qpos
        mujoco.mj_kinematics(model, data)
        free = [item for item in held if model.body(item).dofnum[0] == FREE]  # what is hinged stays where it is
        addresses = {item: int(model.jnt_qposadr[model.body(item).jntadr[0]]) for item in free}
        in_hand = {
            at: compute_inverse(robot.queries.place(data)) @ robot.queries.place(data, each)
            for each, at in addresses.items()
        }
        bodies = [int(model.body(item).id) for item in held]
        is_solid = (model.geom_contype | model.geom_conaffinity) > 0
        is_of_side = (self._owner == self._names.index(name)) | np.isin(model.geom_bodyid, bodies)
        geoms = np.flatnonzero(is_solid & is_of_side)
        address, places = robot.state.posture_address, []
        for q_rad in postures:
            robot.state.write_posture(data, q_rad)
            values = dict(zip(address.tolist(), data.qpos[address].tolist(), strict=True))
            mujoco.mj_kinematics(model, data)
            for at, T in in_hand.items():
                pose = compute_pose(robot.queries.place(data) @ T)
                values |= dict(enumerate((*pose.position_m, *pose.quaternion_wxyz), at))
            data.qpos[list(values)] = list(values.values())
            mujoco.mj_kinematics(model, data)
            places.append(_Place(values, geoms, data.geom_xpos[geoms].copy()))
        return places

    def _measure(self, own: list[_Place], theirs: list[_Place], enough_m: float = -np.inf) -> float:
        """The least distance between two sides in any two of their places [m], infinite beyond `CLEARANCE_M`.

        The search ends with the first that is less than `enough_m`; places whose bounding balls are apart are skipped.
        """
        from scipy.spatial.distance import cdist  # slow to load, for two arms alone

        model, data, least_m = self._model, self._data, np.inf
        sides = np.zeros(model.ngeom, dtype=np.int8)
        sides[own[0].geoms], sides[theirs[0].geoms] = 1, 2
        radii_m = model.geom_rbound[own[0].geoms][:, None] + model.geom_rbound[theirs[0].geoms]
        one_m, two_m = (np.vstack([place.centers_m for place in places]) for places in (own, theirs))
        between_m = cdist(one_m, two_m)
        gaps_m = between_m.reshape(len(own), -1, len(theirs), radii_m.shape[1]) - radii_m[None, :, None]
        data.qpos[:] = self._world.qpos
        for one, two in np.argwhere(gaps_m.min(axis=(1, 3)) < CLEARANCE_M).tolist():
            both = {**own[one].values, **theirs[two].values}
            data.qpos[list(both)] = list(both.values())
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            of_pair = sides[data.contact.geom]
            is_between = (of_pair.min(axis=1) > 0) & (of_pair[:, 0] != of_pair[:, 1])
            least_m = min(least_m, data.contact.dist[is_between].min(initial=np.inf))
            if least_m < enough_m:
                break
        return float(least_m)


def sample(q_rad: Array, slides: int = 0) -> Array:
    """As few postures of a motion (n, n_joints) as turn no joint by more than `SAMPLE_RAD` in between; both ends.

    So many of the first joints slide [m].
    """
    kept, last = [0], len(q_rad) - 1
    turned = q_rad * np.where(np.arange(q_rad.shape[1]) < slides, SLID, 1.0)
    for row in range(1, last + 1):
        if row == last or np.abs(turned[row + 1] - turned[kept[-1]]).max() > SAMPLE_RAD:
            kept.append(row)
    return q_rad[kept]
