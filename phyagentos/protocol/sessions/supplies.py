"""What a target reported of itself over a session, as arrays of its trajectory: place, vitals, items, daylight."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from phyagentos.protocol.world.environment import TargetState

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

BASE, DAYLIGHT, VITAL, ITEM = "base", "daylight", "vital.", "item."  # the last two stand before a name


def tabulate(states: "Sequence[TargetState]") -> "dict[str, Array]":
    """Arrays (n,) by name, and `base` (n, 3): x, y [m], heading [rad]; none for a target that reports none of them.

    An item that was not carried, and a vital that was not reported, count as zero.
    """
    import numpy as np

    if not states:
        return {}
    inventories, vitals = ([getattr(each, kind) or {} for each in states] for kind in ("inventory", "vitals"))
    found = {
        f"{prefix}{name}": np.array([each.get(name, 0) for each in reports], dtype=np.float64)
        for prefix, reports in ((VITAL, vitals), (ITEM, inventories))
        for name in sorted({name for each in reports for name in each})
    }
    if all(each.base is not None for each in states):
        found[BASE] = np.array([each.base for each in states], dtype=np.float64)
    if all(isinstance(each.daylight, float) for each in states):
        found[DAYLIGHT] = np.array([each.daylight for each in states], dtype=np.float64)
    return found


def list_named(course: "Mapping[str, Array]", prefix: str) -> "dict[str, Array]":
    """Of the arrays of a trajectory those of vitals or of items, by their own names."""
    return {name.removeprefix(prefix): each for name, each in course.items() if name.startswith(prefix)}
