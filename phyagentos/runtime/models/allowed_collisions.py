"""The allowed-collision matrix of a robot, found by sampling postures, as MoveIt's setup assistant does it.

Pairs that always touch are switched off in the simulation; pairs that never touch need no test in planning. Pairs are
body names; the same robot gives the same matrix.
"""

import functools
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.hand import measure_hand
from phyagentos.runtime.models.robot import compile_robot
from phyagentos.runtime.models.sources import find_model

Pair = tuple[str, str]
SAMPLES = 3000
ALWAYS = 0.95  # fraction of postures in contact above which a pair is a matter of design, not of posture
SEED = 0


@dataclass(frozen=True, slots=True)
class CollisionMatrix:
    """Pairs of robot bodies: joined by a joint, in contact in more than 95 % of postures, or in none."""

    adjacent: tuple[Pair, ...]
    always: tuple[Pair, ...]
    never: tuple[Pair, ...]

    @property
    def excluded(self) -> tuple[Pair, ...]:
        """Pairs to switch off in the simulation too."""
        return tuple(sorted({*self.adjacent, *self.always}))

    @property
    def idle(self) -> tuple[Pair, ...]:
        """Pairs that planning need not test."""
        return (*self.adjacent, *self.always, *self.never)


def compute_collision_matrix(profile: TargetProfile, folder: Path) -> CollisionMatrix:
    """The matrix of a robot whose model is in `folder`; computed once per robot file and process."""
    return _compute(profile, folder, find_model(profile.model, folder).stat().st_mtime_ns)


def exclude_pairs(spec: mujoco.MjSpec, pairs: tuple[Pair, ...]) -> None:
    """Switch the collision of body pairs off, unless the file already does."""
    known = {frozenset((exclude.bodyname1, exclude.bodyname2)) for exclude in spec.excludes}
    for first, second in pairs:
        if frozenset((first, second)) not in known:
            spec.add_exclude(name=f"{first}|{second}", bodyname1=first, bodyname2=second)


@functools.lru_cache(maxsize=16)
def _compute(profile: TargetProfile, folder: Path, _changed_ns: int) -> CollisionMatrix:
    model = compile_robot(profile, folder)
    data = mujoco.MjData(model)
    hand = measure_hand(profile, folder)
    for name, position in zip(hand.joints, hand.pose(profile.gripper.max_width_m), strict=True):
        data.qpos[model.joint(name).qposadr[0]] = position
    return sample_collision_matrix(model, data, [int(model.joint(name).qposadr[0]) for name in profile.arm.joints])


def sample_collision_matrix(model: mujoco.MjModel, data: mujoco.MjData, addresses: list[int]) -> CollisionMatrix:
    """Classify every pair of colliding bodies of a robot that is alone in its model.

    The arm's joints (addresses in `qpos`) are sampled within their ranges; others keep their positions in `data`.
    """
    ranges = {int(model.jnt_qposadr[joint]): model.jnt_range[joint] for joint in range(model.njnt)}
    counts = _count_contacts(model, data, addresses, np.array([ranges[address] for address in addresses]))
    bodies = [body for body in range(1, model.nbody) if _collides(model, body)]
    adjacent: list[Pair] = []
    always: list[Pair] = []
    never: list[Pair] = []
    weld, parent = model.body_weldid, model.body_parentid
    for index, first in enumerate(bodies):
        for second in bodies[index + 1 :]:
            if weld[first] == weld[second]:
                continue
            a, b = sorted((model.body(first).name, model.body(second).name))
            fraction = counts[first, second] / SAMPLES
            if weld[parent[weld[second]]] == weld[first] or weld[parent[weld[first]]] == weld[second]:
                adjacent.append((a, b))
            elif fraction > ALWAYS:
                always.append((a, b))
            elif fraction == 0.0:
                never.append((a, b))
    return CollisionMatrix(tuple(sorted(adjacent)), tuple(sorted(always)), tuple(sorted(never)))


def _count_contacts(
    model: mujoco.MjModel, data: mujoco.MjData, addresses: list[int], ranges: NDArray[np.float64]
) -> NDArray[np.intp]:
    """(n_bodies, n_bodies) postures in which two bodies touch; upper triangle."""
    rng = np.random.default_rng(SEED)
    counts = np.zeros((model.nbody, model.nbody), dtype=np.intp)
    touching = np.zeros_like(counts, dtype=np.bool_)
    for q in rng.uniform(ranges[:, 0], ranges[:, 1], size=(SAMPLES, len(addresses))):
        data.qpos[addresses] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = np.sort(model.geom_bodyid[data.contact.geom[: data.ncon]], axis=1)
        touching[:] = False
        touching[pairs[:, 0], pairs[:, 1]] = True
        counts += touching
    return counts


def _collides(model: mujoco.MjModel, body: int) -> bool:
    start = model.body_geomadr[body]
    geoms = slice(start, start + model.body_geomnum[body])
    return bool(np.any(model.geom_contype[geoms] | model.geom_conaffinity[geoms]))
