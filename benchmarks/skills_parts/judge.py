"""Facts of a recorded simulator state, by MuJoCo and numpy alone: no code of the package decides here."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

CELL_M, TOUCH_M, SWEPT = 0.005, 0.003, 0.95  # of a swept area
STILL_M, CLOSING_M = 0.0002, 0.005  # of fingers that hold something, in a control period
HELD_M = 0.06  # of the middle of what they hold from between the pads
UPRIGHT_COS = np.cos(np.radians(15))
Array = np.ndarray
MOVED_M, MOVED_RAD, REST_M_S = 0.015, np.radians(10), 0.03
OPEN, CLOSED = 0.9, 0.1  # fractions of the travel, as the predicates are documented


class Judge:
    """One recorded end, and the start that it is compared with."""

    def __init__(self, bundle: Path, start: Path) -> None:
        self._bundle = bundle
        self._model = mujoco.MjModel.from_binary_path(str(bundle / "scene.mjb"))
        self._now, self._then = self._load(bundle / "terminal.npz"), self._load(start / "initial.npz")

    def _load(self, path: Path) -> mujoco.MjData:
        data = mujoco.MjData(self._model)
        with np.load(path) as stored:
            mujoco.mj_setState(self._model, data, stored["state"], mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self._model, data)
        return data

    def find_unmet(self, facts: tuple[tuple[Any, ...], ...]) -> list[str]:
        """The facts that are not so."""
        return [" ".join(map(str, fact)) for fact in facts if not getattr(self, f"_is_{fact[0]}")(*fact[1:])]

    def _is_open(self, thing: str) -> bool:
        return self._opening(thing) >= OPEN

    def _is_closed(self, thing: str) -> bool:
        return self._opening(thing) <= CLOSED

    def _opening(self, thing: str) -> float:
        joint = self._model.joint(f"{thing}_joint")
        low, high = joint.range
        return float((self._now.qpos[joint.qposadr[0]] - low) / (high - low))

    def _is_borne(self, thing: str, support: str) -> bool:
        """At rest, with half of its weight or more on the support."""
        body, other = self._model.body(thing).id, self._model.body(support).id
        lift = 0.0
        for index in range(self._now.ncon):
            contact = self._now.contact[index]
            owners = [int(self._model.geom_bodyid[geom]) for geom in contact.geom]
            if sorted(owners) == sorted((body, other)):
                force = np.zeros(6)
                mujoco.mj_contactForce(self._model, self._now, index, force)
                up = float((contact.frame.reshape(3, 3).T @ force[:3])[2])
                lift += up if owners[1] == body else -up
        return lift >= 0.5 * 9.81 * float(self._model.body_mass[body]) and self._speed(thing) < REST_M_S

    def _is_plugged(self, peg: str, socket: str, deep_m: float, tall_m: float) -> bool:
        """At rest and let go, with its lower end within the hole by half of its depth and more."""
        body, other = self._model.body(peg).id, self._model.body(socket).id
        rim_m = self._now.xpos[other][2] + 0.004 + 2 * deep_m
        lowest_m = self._now.xpos[body][2] - tall_m
        pairs = [set(self._model.geom_bodyid[contact.geom].tolist()) for contact in self._now.contact]
        is_free = all(pair == {body, other} for pair in pairs if body in pair)
        return bool(rim_m - lowest_m >= deep_m) and is_free and self._speed(peg) < REST_M_S

    def _is_upright(self, thing: str, is_alike: bool) -> bool:
        """Its z axis up, or down where both ends are alike."""
        up = float(self._now.body(thing).xmat[8])
        return bool((abs(up) if is_alike else up) >= UPRIGHT_COS)

    def _is_beside(self, thing: str, x_m: float, y_m: float, half_x_m: float, half_y_m: float) -> bool:
        """At rest, with its middle outside of a rectangle."""
        x, y, _ = self._now.body(thing).xpos
        is_out = abs(x - x_m) > half_x_m or abs(y - y_m) > half_y_m
        return bool(is_out) and self._speed(thing) < REST_M_S

    def _is_swept(self, block: str, x_m: float, y_m: float, half_x_m: float, half_y_m: float) -> bool:
        """In the sessions of the goal, a held block touched all of a rectangle of the table, by the measured joints."""
        axes = [np.arange(c - h, c + h, CELL_M) for c, h in ((x_m, half_x_m), (y_m, half_y_m))]
        cells = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2) + CELL_M / 2
        swept = np.zeros(len(cells), dtype=bool)
        half = self._model.geom_size[self._model.body(block).geomadr[0]]
        for bundle in sorted(self._bundle.parent.glob(f"{self._bundle.name.split('.')[0]}.*")):
            for pose in self._iter_held(block, bundle):
                if pose[2, 3] - np.abs(pose[2, :3]) @ half <= TOUCH_M:
                    local = (np.column_stack((cells, np.zeros(len(cells)))) - pose[:3, 3]) @ pose[:3, :3]
                    level = np.abs(pose[2, :3]) < 0.5
                    swept |= (np.abs(local)[:, level] <= half[level]).all(axis=1)
        return bool(swept.mean() >= SWEPT)

    def _iter_held(self, block: str, bundle: Path) -> Iterator[Array]:
        """World poses (4, 4) of a block while the fingers hold it, by the measured joints and where it was taken."""
        data, start = mujoco.MjData(self._model), _pose(self._load(bundle / "initial.npz").body(block))
        with np.load(bundle / "trajectory.npz") as stored:
            joints, widths = stored["q_measured"], stored["gripper_measured_m"]
        closed = (np.abs(np.diff(widths)) < STILL_M) & (widths[1:] < np.max(widths, initial=0.0) - CLOSING_M)
        taken = None
        for row in np.flatnonzero(closed) + 1:
            for index, angle in enumerate(joints[row]):
                data.qpos[self._model.joint(f"joint{index + 1}").qposadr[0]] = angle
            mujoco.mj_kinematics(self._model, data)
            tool = _pose(data.site("tcp"))
            taken = np.linalg.inv(tool) @ start if taken is None else taken
            if np.linalg.norm(taken[:3, 3]) < HELD_M:  # else something else is held
                yield tool @ taken

    def _is_poured(self, cup: str, bowl: str, least: int) -> bool:
        """At least so many of the cup's balls at rest, and borne by nothing but the bowl and each other."""
        balls = [index for index in range(self._model.nbody) if self._model.body(index).name.startswith(f"{cup}.")]
        pairs = [set(self._model.geom_bodyid[contact.geom].tolist()) for contact in self._now.contact]
        inside, grown = {self._model.body(bowl).id}, True
        while grown:  # what touches the bowl, what touches that, ...
            reached = {ball for ball in balls for pair in pairs if ball in pair and pair & inside} - inside
            inside, grown = inside | reached, bool(reached)
        others = {body for pair in pairs if pair & set(balls) for body in pair} - {*balls, self._model.body(bowl).id}
        stray = {ball for ball in balls for pair in pairs if ball in pair and pair & others}
        still = [b for b in balls if b in inside - stray and self._speed(self._model.body(b).name) < REST_M_S]
        return len(still) >= least

    def _is_kept(self, thing: str) -> bool:
        """Where it was, and as it was turned."""
        body = self._model.body(thing).id
        way = np.linalg.norm(self._now.xpos[body] - self._then.xpos[body])
        turned = 2 * np.arccos(np.clip(abs(self._now.xquat[body] @ self._then.xquat[body]), 0, 1))
        return bool(way <= MOVED_M and turned <= MOVED_RAD)

    def _speed(self, thing: str) -> float:
        velocity = np.zeros(6)
        kind = mujoco.mjtObj.mjOBJ_BODY
        mujoco.mj_objectVelocity(self._model, self._now, kind, self._model.body(thing).id, velocity, 0)
        return float(np.linalg.norm(velocity[3:]))


def _pose(frame: Any) -> Array:
    """(4, 4) of a body or site of MuJoCo's data."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = frame.xmat.reshape(3, 3), frame.xpos
    return pose
