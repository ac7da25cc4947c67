"""Another eye: whether an objective is met, from raw MuJoCo state alone; nothing of the framework is imported.

Each question has an answer and the distance from where it turns over. A case nearer than `KEEP_AWAY` to that boundary
is left out by the generator, since two honest judges may differ there: 2.5 mm, or 3 degrees, on either side. What rests
*on* something is told by contact forces, what is *held* by the forces on both pads; the pipeline knows neither.
"""

import re
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np

KEEP_AWAY = 1.0  # of a margin, which counts 1 for each of the units below
UNIT_M, UNIT_RAD = 0.0025, np.radians(3.0)
REST_M_S = 0.05
RIM_M = 0.003
MOVED_M, MOVED_RAD = 0.015, np.radians(10.0)
UPRIGHT_RAD = np.radians(15.0)
TOUCH_N = 0.05  # a force that is no rounding
CLOSED = 0.1
SURE = 100.0  # a margin for what is true or false without any doubt


@dataclass(frozen=True, slots=True)
class Answer:
    """Whether it is met, and how far it is from turning over: in units of `KEEP_AWAY`."""

    met: bool
    margin: float

    @property
    def is_decided(self) -> bool:
        """Whether it is far enough from the boundary for everybody to agree."""
        return self.margin >= KEEP_AWAY


class Eye:
    """Looks at one world.

    Args:
        model: Of the world.
        before: qpos (nq,) when the session began.
        pads: Names of the finger pads.
        interiors: Container -> centre (3,) and half extents (3,) of where things can be put, in its frame.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        before: np.ndarray,
        pads: tuple[str, ...],
        interiors: dict[str, tuple[np.ndarray, np.ndarray]],
    ) -> None:
        self._model, self._pads, self._interiors = model, {model.geom(pad).id for pad in pads}, interiors
        self._then = mujoco.MjData(model)
        self._then.qpos[:] = before
        mujoco.mj_kinematics(model, self._then)
        self._now = self._then

    def judge(self, data: mujoco.MjData, criteria: tuple[str, ...]) -> Answer:
        """Whether all criteria are met in a state whose forces are known (`mj_forward`)."""
        self._now = data
        return _all([self._judge(text) for text in criteria])

    def _judge(self, text: str) -> Answer:
        if " or " in text:
            return _any([self._judge(part) for part in text.split(" or ")])
        if text.startswith("not "):
            answer = self._judge(text.removeprefix("not "))
            return Answer(not answer.met, answer.margin)
        counted = re.fullmatch(r"count\(inside\(\*, (\w+)\)\) >= (\d+)", text)
        if counted:
            return self._count_in_vessel(counted[1], int(counted[2]))
        tilted = re.fullmatch(r"tilt\((\w+)\) <= ([\d.]+)", text)
        if tilted:
            return self._is_within_tilt(tilted[1], float(tilted[2]))
        call = re.fullmatch(r"(\w+)\((.*)\)", text)
        if call is None:
            raise ValueError(f"the eye cannot read {text!r}")
        name, arguments = call[1], [part.strip() for part in re.split(r",\s*(?![^(]*\))", call[2])]
        return getattr(self, f"_is_{name}")(*arguments)

    # -- questions -----------------------------------------------------------------------------------------------------

    def _is_inside(self, thing: str, container: str) -> Answer:
        if thing == "*":
            free = [self._model.body(index).name for index in range(self._model.nbody) if self._is_free(index)]
            return _any([self._is_inside(name, container) for name in free])
        if container not in self._interiors:
            return Answer(False, SURE)
        center, half = self._interiors[container]
        rotation, origin = self._frame(container)
        points = (self._corners(thing) - origin) @ rotation - center
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        slack = [
            *(half[:2] - abs(middle[:2])),
            half[2] - RIM_M - points[:, 2].min(),
            points[:, 2].min() + half[2] + 0.01,
        ]
        return _all([Answer(each >= 0, abs(each) / UNIT_M) for each in slack] + [self._rests(thing)])

    def _is_on(self, thing: str, support: str) -> Answer:
        """It presses on it, from above, with its middle over it."""
        middle = self._middle(thing)
        slack = self._find_room(support, middle[:2]) + 0.005
        touches = self._force_between(thing, support) > TOUCH_N
        over = Answer(slack >= 0, abs(slack) / UNIT_M)
        above = self._corners(thing)[:, 2].min() > self._frame(support)[1][2] - 0.03
        return _all([over, Answer(touches and bool(above), SURE), self._rests(thing)])

    def _is_holding(self, _target: str, thing: str) -> Answer:
        forces = [self._force_on_pad(pad, thing) for pad in self._pads]
        return Answer(all(force > TOUCH_N for force in forces), SURE)

    def _is_at(self, thing: str, x: str, tolerance_m: str) -> Answer:
        point = np.array([float(part) for part in x.strip("()").split(",")])
        slack = float(tolerance_m) - float(np.linalg.norm(self._middle(thing) - point))
        return _all([Answer(slack >= 0, abs(slack) / UNIT_M), self._rests(thing)])

    def _is_upright(self, thing: str) -> Answer:
        return self._is_within_tilt(thing, UPRIGHT_RAD)

    def _is_within_tilt(self, thing: str, limit_rad: float) -> Answer:
        tilt = float(np.arccos(np.clip(self._frame(thing)[0][2, 2], -1, 1)))
        return Answer(tilt <= limit_rad, abs(tilt - limit_rad) / UNIT_RAD)

    def _is_moved(self, thing: str) -> Answer:
        if thing != "*":
            return self._has_moved(thing)
        free = [self._model.body(index).name for index in range(self._model.nbody) if self._is_free(index)]
        return _any([self._has_moved(name) for name in free])

    def _is_visible(self, thing: str) -> Answer:
        """One of three straight looks from above meets it first."""
        target = self._middle(thing)
        hits = 0
        for offset in ((0.0, 0.0, 1.0), (0.5, 0.0, 0.9), (0.3, 0.5, 0.9)):
            start = target + np.array(offset)
            geom = np.zeros(1, dtype=np.int32)
            mujoco.mj_ray(self._model, self._now, start, target - start, None, 1, -1, geom)
            hits += geom[0] >= 0 and self._model.body(self._model.geom_bodyid[geom[0]]).name == thing
        return Answer(hits > 0 and target[2] > -0.1, SURE)

    def _is_closed(self, thing: str) -> Answer:
        joint = int(self._model.body(thing).jntadr[0])
        low, high = self._model.jnt_range[joint]
        opening = (self._now.qpos[self._model.jnt_qposadr[joint]] - low) / (high - low)
        return Answer(opening <= CLOSED, abs(opening - CLOSED) * (high - low) / UNIT_M)

    def _count_in_vessel(self, vessel: str, least: int) -> Answer:
        """Balls between the walls of an upright cup; margins of single balls do not matter, they roll in or out."""
        center, half = self._interiors[vessel]
        rotation, origin = self._frame(vessel)
        names = (self._model.body(index).name for index in range(self._model.nbody))
        points = [(self._now.body(name).xpos - origin) @ rotation - center for name in names if name.startswith("ball")]
        inside = sum(np.hypot(*point[:2]) < half[0] + 0.002 and abs(point[2]) < half[2] + 0.004 for point in points)
        return Answer(inside >= least, SURE)

    # -- facts ---------------------------------------------------------------------------------------------------------

    def _has_moved(self, thing: str) -> Answer:
        (now, here), (then, there) = self._frame(thing), self._frame(thing, self._then)
        way = float(np.linalg.norm(here - there))
        turn = float(np.arccos(np.clip((np.trace(now.T @ then) - 1) / 2, -1, 1)))
        return _any(
            [
                Answer(way > MOVED_M, abs(way - MOVED_M) / UNIT_M),
                Answer(turn > MOVED_RAD, abs(turn - MOVED_RAD) / UNIT_RAD),
            ]
        )

    def _rests(self, thing: str) -> Answer:
        body = self._model.body(thing)
        if not self._is_free(body.id):
            return Answer(True, SURE)
        speed = float(np.linalg.norm(self._now.qvel[body.dofadr[0] : body.dofadr[0] + 3]))
        return Answer(speed < REST_M_S, SURE)

    def _is_free(self, body: int) -> bool:
        joint = int(self._model.body_jntadr[body])
        return joint >= 0 and self._model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE

    def _frame(self, thing: str, data: mujoco.MjData | None = None) -> tuple[np.ndarray, np.ndarray]:
        seen = (data or self._now).body(thing)
        return seen.xmat.reshape(3, 3).copy(), seen.xpos.copy()

    def _middle(self, thing: str) -> np.ndarray:
        corners = self._corners(thing)
        return (corners.min(axis=0) + corners.max(axis=0)) / 2

    def _corners(self, thing: str) -> np.ndarray:
        """(n, 3) corners of the boxes around a body's solids, in the world."""
        model, found = self._model, []
        for geom in self._solids(thing):
            size = model.geom_size[geom]
            match int(model.geom_type[geom]):
                case mujoco.mjtGeom.mjGEOM_BOX:
                    half = size
                case mujoco.mjtGeom.mjGEOM_SPHERE:
                    half = np.repeat(size[0], 3)
                case mujoco.mjtGeom.mjGEOM_CAPSULE:
                    half = np.array([size[0], size[0], size[0] + size[1]])
                case _:
                    half = np.array([size[0], size[0], size[1]])
            corners = np.array(list(product((-1, 1), repeat=3))) * half
            found.append(corners @ self._now.geom_xmat[geom].reshape(3, 3).T + self._now.geom_xpos[geom])
        return np.concatenate(found)

    def _find_room(self, support: str, point: np.ndarray) -> float:
        """How far a point (2,) is within the edge of a support seen from above [m]; a disk, or a box along the axes."""
        solids = self._solids(support)
        if len(solids) == 1 and self._model.geom_type[solids[0]] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            away = point - self._now.geom_xpos[solids[0]][:2]
            return float(self._model.geom_size[solids[0]][0] - np.hypot(*away))
        corners = self._corners(support)[:, :2]
        return float(min((corners.max(axis=0) - point).min(), (point - corners.min(axis=0)).min()))

    def _solids(self, thing: str) -> list[int]:
        model, body = self._model, self._model.body(thing).id
        geoms = np.flatnonzero(model.geom_bodyid == body)
        return [int(geom) for geom in geoms if model.geom_contype[geom] or model.geom_conaffinity[geom]]

    def _force_between(self, first: str, second: str) -> float:
        """Magnitude [N] of all contact forces between two bodies."""
        return self._sum_forces(set(self._solids(first)), set(self._solids(second)))

    def _force_on_pad(self, pad: int, thing: str) -> float:
        return self._sum_forces({pad}, set(self._solids(thing)))

    def _sum_forces(self, ours: set[int], theirs: set[int]) -> float:
        total, wrench = 0.0, np.zeros(6)
        for index in range(self._now.ncon):
            pair = [int(each) for each in self._now.contact.geom[index]]
            if (pair[0] in ours and pair[1] in theirs) or (pair[1] in ours and pair[0] in theirs):
                mujoco.mj_contactForce(self._model, self._now, index, wrench)
                total += abs(wrench[0])
        return total


def _all(answers: list[Answer]) -> Answer:
    missed = [each for each in answers if not each.met]
    if missed:
        return Answer(False, max(each.margin for each in missed))
    return Answer(True, min(each.margin for each in answers))


def _any(answers: list[Answer]) -> Answer:
    met = [each for each in answers if each.met]
    if met:
        return Answer(True, max(each.margin for each in met))
    return Answer(False, min(each.margin for each in answers))
