"""A short way out of contact: for an arm that a planner finds touching something where it stands.

Upstream: `moves`. Obstacles are believed a few millimetres larger than they are, and things fall against fingers; so a
start in contact is common after a failure, and no reason to give up. Only what is touched at the start may be touched
on the way out, and never again afterwards.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phyagentos.runtime.motion.planning_scene import Pair, PlanningScene

Array = NDArray[np.float64]

RADII_RAD = (0.05, 0.1, 0.2, 0.35)  # the nearest way out first
DIRECTIONS = 48  # tried at each radius
STEP_RAD = 0.02


def find_escape(start_rad: Array, touched: Sequence[Pair], scene: PlanningScene, seed: int) -> Array | None:
    """A free posture (n_joints,) near the start, reached in a straight line; None when there is none.

    Args:
        start_rad: (n_joints,) where the arm stands.
        touched: What it touches there.
        scene: Exact contacts.
        seed: Of the directions.
    """
    rng = np.random.default_rng(seed)
    for radius in RADII_RAD:
        for direction in rng.normal(size=(DIRECTIONS, len(start_rad))):
            beside = start_rad + radius * direction / np.linalg.norm(direction)
            goal: Array = np.clip(beside, scene.robot.q_min_rad, scene.robot.q_max_rad)
            steps = np.linspace(0.0, 1.0, 1 + int(np.ceil(radius / STEP_RAD)))[1:, None]
            if leaves_contact(start_rad + steps * (goal - start_rad), touched, scene):
                return goal
    return None


def leaves_contact(rows_rad: Array, touched: Sequence[Pair], scene: PlanningScene) -> bool:
    """Whether a motion (k, n_joints) touches only what it touched at its start, then nothing, to its end."""
    is_out = False
    for q in rows_rad:
        contacts = scene.find_contacts(q)
        if contacts and (is_out or not set(contacts) <= set(touched)):
            return False
        is_out = is_out or not contacts
    return is_out
