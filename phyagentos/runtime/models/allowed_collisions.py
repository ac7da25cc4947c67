"""The allowed-collision matrix of a robot, found by sampling postures, as MoveIt's setup assistant does it.

Upstream: `robot`. Downstream: `scene` (pairs that always touch are switched off in the simulation) and the planning
model (pairs that never touch need no test). Pairs are body names, sorted; the same robot gives the same matrix.
"""

import functools
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.robot import build_robot

Pair = tuple[str, str]
SAMPLES = 3000
ALWAYS = 0.95  # fraction of postures in contact above which a pair is a matter of design, not of posture
SEED = 0


@dataclass(frozen=True, slots=True)
class CollisionMatrix:
    """Which pairs of robot bodies need no collision test.

    Attributes:
        adjacent: Joined by a joint.
        always: In contact in more than 95 % of postures.
        never: In contact in no sampled posture.
    """

    adjacent: tuple[Pair, ...]
    always: tuple[Pair, ...]
    never: tuple[Pair, ...]

    @property
    def excluded(self) -> tuple[Pair, ...]:
        """Pairs to switch off in the simulation too."""
        return tuple(sorted({*self.adjacent, *self.always}))


def compute_collision_matrix(profile: TargetProfile, folder: Path) -> CollisionMatrix:
    """Sample postures of the arm (fingers open) and sort every pair of colliding bodies.

    Args:
        profile: The robot.
        folder: Where its model lies.

    Returns:
        The matrix; computed once per robot file and process.
    """
    path = folder / profile.model
    return _compute(profile, folder, path.stat().st_mtime_ns)


def exclude_pairs(spec: mujoco.MjSpec, pairs: tuple[Pair, ...]) -> None:
    """Switch the collision of body pairs off."""
    for first, second in pairs:
        spec.add_exclude(name=f"{first}|{second}", bodyname1=first, bodyname2=second)


@functools.lru_cache(maxsize=16)
def _compute(profile: TargetProfile, folder: Path, _changed_ns: int) -> CollisionMatrix:
    model = build_robot(profile, folder).compile()
    counts = _count_contacts(model, profile)
    bodies = [body for body in range(1, model.nbody) if _collides(model, body)]
    adjacent: list[Pair] = []
    always: list[Pair] = []
    never: list[Pair] = []
    for index, first in enumerate(bodies):
        for second in bodies[index + 1 :]:
            if model.body_weldid[first] == model.body_weldid[second]:
                continue
            a, b = sorted((model.body(first).name, model.body(second).name))
            fraction = counts.get((first, second), 0) / SAMPLES
            if _is_adjacent(model, first, second):
                adjacent.append((a, b))
            elif fraction > ALWAYS:
                always.append((a, b))
            elif fraction == 0.0:
                never.append((a, b))
    return CollisionMatrix(tuple(sorted(adjacent)), tuple(sorted(always)), tuple(sorted(never)))


def _count_contacts(model: mujoco.MjModel, profile: TargetProfile) -> dict[tuple[int, int], int]:
    data = mujoco.MjData(model)
    rng = np.random.default_rng(SEED)
    joints = [model.joint(name) for name in profile.arm.joints]
    address = [int(joint.qposadr[0]) for joint in joints]
    low, high = np.array([joint.range for joint in joints]).T
    for name in profile.gripper.joints:
        data.qpos[model.joint(name).qposadr[0]] = profile.gripper.max_width_m / len(profile.gripper.joints)
    counts: dict[tuple[int, int], int] = {}
    for _ in range(SAMPLES):
        data.qpos[address] = rng.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = np.sort(model.geom_bodyid[data.contact.geom[: data.ncon]], axis=1)
        for first, second in {(int(a), int(b)) for a, b in pairs}:
            counts[first, second] = counts.get((first, second), 0) + 1
    return counts


def _collides(model: mujoco.MjModel, body: int) -> bool:
    start = model.body_geomadr[body]
    geoms = slice(start, start + model.body_geomnum[body])
    return bool(np.any(model.geom_contype[geoms] | model.geom_conaffinity[geoms]))


def _is_adjacent(model: mujoco.MjModel, first: int, second: int) -> bool:
    weld, parent = model.body_weldid, model.body_parentid
    return bool(weld[parent[weld[second]]] == weld[first] or weld[parent[weld[first]]] == weld[second])
