"""Facts of a recorded simulator state, by MuJoCo and numpy alone: no code of the package decides here."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

MOVED_M, MOVED_RAD, REST_M_S = 0.015, np.radians(10), 0.03
OPEN, CLOSED = 0.9, 0.1  # fractions of the travel, as the predicates are documented


class Judge:
    """One recorded end, and the start that it is compared with."""

    def __init__(self, bundle: Path, start: Path) -> None:
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
