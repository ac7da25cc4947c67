"""Motions of objects that slide or turn: where they stand at an opening, and which opening a point of them shows."""

from typing import TYPE_CHECKING

from phyagentos.geometry import compute_rotation, make_matrix, rotate, turn
from phyagentos.protocol.world.environment import Entity, Mechanism

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def find_hinge(entity: Entity) -> tuple[float, float, float] | None:
    """Direction of an entity's hinge in the world; None without one."""
    mechanism = entity.mechanism
    if mechanism is None or mechanism.kind != "hinge":
        return None
    return rotate(mechanism.closed.quaternion_wxyz, mechanism.axis)


def compute_motion(mechanism: Mechanism, amount: float) -> "Array":
    """(4, 4) displacement in the world that opens an object by an amount [m], or [rad] for a hinge."""
    import numpy as np

    axis, anchor = _place_axis(mechanism)
    if mechanism.kind != "hinge":
        return make_matrix(np.eye(3), axis * amount)
    rotation = turn(axis * amount)
    return make_matrix(rotation, anchor - rotation @ anchor)


def measure_amount(mechanism: Mechanism, point_m: "Array", at_m: "Array") -> float:
    """How far an object is open [m or rad], not limited to its travel.

    Args:
        mechanism: How it opens.
        point_m: (3,) a point of the object, in its own frame.
        at_m: (3,) where that point is, in the world.
    """
    import numpy as np

    axis, anchor = _place_axis(mechanism)
    start = compute_rotation(mechanism.closed.quaternion_wxyz) @ point_m + np.array(mechanism.closed.position_m)
    if mechanism.kind != "hinge":
        return float(axis @ (at_m - start))
    u, v = start - anchor, at_m - anchor
    angle = float(np.arctan2(axis @ np.cross(u, v), u @ v - (axis @ u) * (axis @ v)))
    least = mechanism.travel / 2 - np.pi  # what lies beyond both ends belongs to the nearer one
    return angle if angle >= least else angle + 2 * float(np.pi)


def compute_twist(mechanism: Mechanism, at_m: "Array") -> "Array":
    """(6,) motion along and turn about the world's axes, for one metre of the path of a point at `at_m` (3,)."""
    import numpy as np

    axis, anchor = _place_axis(mechanism)
    if mechanism.kind != "hinge":
        return np.concatenate((axis, np.zeros(3)))
    along = np.cross(axis, at_m - anchor)
    return np.concatenate((along, axis)) / max(float(np.linalg.norm(along)), 1e-3)  # nearer to the axis, no turn shows


def _place_axis(mechanism: Mechanism) -> "tuple[Array, Array]":
    """(3,) direction and (3,) a point of the axis, in the world."""
    import numpy as np

    rotation = compute_rotation(mechanism.closed.quaternion_wxyz)
    anchor = rotation @ np.array(mechanism.anchor_m) + np.array(mechanism.closed.position_m)
    return rotation @ np.array(mechanism.axis), anchor
