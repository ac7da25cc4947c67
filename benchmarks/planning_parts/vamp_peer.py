"""A peer of motion planning in an environment of its own: VAMP's Panda, over the solids of the same queries."""

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.planning_parts.query_sets import Query
from phyagentos.geometry import compute_matrix
from phyagentos.protocol.world.environment import Entity, ShapeKind

SCRIPT = Path(__file__).with_name("run_vamp.py")


def ask_vamp(python: str, queries: Sequence[Query]) -> list[tuple[float, float | None]]:
    """Time of path and simplification [ms] and length [rad] of each query; None where it finds none.

    Args:
        python: The interpreter that has `vamp`, whose Panda is the arm of the queries.
        queries: Entities that are held or left out are no obstacles to it, and what is held has no solid.
    """
    asked = [
        {
            "start": query.move.q_rad.tolist(),
            "goals": np.atleast_2d(query.move.goals_rad).tolist(),
            "solids": [solid for entity in query.move.world.entities for solid in _list_solids(entity, query)],
        }
        for query in queries
    ]
    answered = subprocess.run([python, SCRIPT], input=json.dumps(asked), capture_output=True, text=True, check=True)
    return [(ms, length_rad) for ms, length_rad in json.loads(answered.stdout)]


def _list_solids(entity: Entity, query: Query) -> list[tuple[ShapeKind, list[float], list[float], list[float]]]:
    """Kind, centre [m], angles about the fixed axes x, y, z [rad] and half sizes [m] of each solid in the world."""
    held = query.move.payload.entity if query.move.payload else ""
    if entity.name in {held, *query.move.ignore}:
        return []
    solids = []
    for shape in entity.shapes:
        T = compute_matrix(entity.pose) @ compute_matrix(shape.pose)
        angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz").tolist()
        solids.append((shape.kind, T[:3, 3].tolist(), angles, list(shape.size_m)))
    return solids
