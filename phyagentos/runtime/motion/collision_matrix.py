"""Which pairs of robot bodies need no collision test while planning, found by sampling postures.

The same idea as the setup assistant of MoveIt: neighbours in the chain and pairs that always touch are a matter of
design; pairs that never touch cost time for nothing. The simulation leaves out the former only, hence two matrices.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

Pair = tuple[str, str]

SAMPLES = 3000
ALWAYS = 0.95  # fraction of postures in contact above which a pair is a matter of design
SEED = 0


def find_idle_pairs(
    model: mujoco.MjModel, q_min_rad: NDArray[np.float64], q_max_rad: NDArray[np.float64]
) -> tuple[Pair, ...]:
    """Pairs of bodies that are adjacent, always in contact, or never.

    Args:
        model: The robot alone; its joints are the model's only ones.
        q_min_rad: (n_joints,) lower limits.
        q_max_rad: (n_joints,) upper limits.
    """
    data = mujoco.MjData(model)
    rng = np.random.default_rng(SEED)
    counts = np.zeros((model.nbody, model.nbody), dtype=int)
    for q in rng.uniform(q_min_rad, q_max_rad, size=(SAMPLES, model.nq)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = np.unique(np.sort(model.geom_bodyid[data.contact.geom[: data.ncon]], axis=1), axis=0)
        counts[pairs[:, 0], pairs[:, 1]] += 1
    bodies = [body for body in range(1, model.nbody) if model.body_geomnum[body] > 0]
    return tuple(
        (model.body(a).name, model.body(b).name)
        for index, a in enumerate(bodies)
        for b in bodies[index + 1 :]
        if model.body_weldid[a] != model.body_weldid[b]
        and (_is_adjacent(model, a, b) or counts[a, b] == 0 or counts[a, b] > ALWAYS * SAMPLES)
    )


def exclude_pairs(spec: mujoco.MjSpec, pairs: tuple[Pair, ...]) -> None:
    """Switch the collision of body pairs off, unless the file already does."""
    known = {frozenset((exclude.bodyname1, exclude.bodyname2)) for exclude in spec.excludes}
    for first, second in pairs:
        if frozenset((first, second)) not in known:
            spec.add_exclude(name=f"idle:{first}|{second}", bodyname1=first, bodyname2=second)


def _is_adjacent(model: mujoco.MjModel, first: int, second: int) -> bool:
    weld, parent = model.body_weldid, model.body_parentid
    return bool(weld[parent[weld[second]]] == weld[first] or weld[parent[weld[first]]] == weld[second])
