"""Where the tool centre point may be, as planning sees it: solids that a small ball about it must not meet.

The numbers are those of safety.yaml. The guard shares no code with this and enforces them on every command.
"""

from collections.abc import Iterator, Mapping
from typing import cast

import numpy as np

from phyagentos.protocol.documents.schema import Corners
from phyagentos.protocol.settings.safety import TargetLimits
from phyagentos.runtime.motion.requests import Array

ToolBounds = Mapping[str, Corners]
"""Least and greatest corner in the world [m] of `workspace_box`, which the point stays in, and of `keep_out.<name>`."""

ANYWHERE: ToolBounds = {}
BALL_M = 0.01  # its radius: a measured tool is beside the planned one by tracking and by the noise of its encoders
WALL_M = 10.0  # half thickness of what surrounds the workspace: no arm reaches through it
WORKSPACE, KEEP_OUT = "workspace_box", "keep_out."


def read_tool_bounds(limits: TargetLimits) -> dict[str, Corners]:
    """The bounds that safety.yaml sets for a target."""
    boxes = {WORKSPACE: limits.workspace_box} | {KEEP_OUT + name: each for name, each in limits.keep_out.items()}
    return {name: cast("Corners", limit.value) for name, limit in boxes.items()}


def iter_walls(bounds: ToolBounds) -> Iterator[tuple[str, Array, Array]]:
    """Boxes that the ball must not meet: name of the limit, centre (3,), half extents (3,) [m]."""
    for name, corners in bounds.items():
        low, high = np.array(corners)
        if name != WORKSPACE:
            yield name, (low + high) / 2.0, (high - low) / 2.0
            continue
        for corner, side in ((low, -WALL_M), (high, WALL_M)):
            yield from ((name, axis * (corner + side), np.full(3, WALL_M)) for axis in np.eye(3))


def find_wall(bounds: ToolBounds, point_m: Array) -> str:
    """The limit that a point (3,) itself is beyond, whatever the arm's posture; empty where there is none."""
    x, y, z = point_m.tolist()
    for name, ((x0, y0, z0), (x1, y1, z1)) in bounds.items():
        if (x0 < x < x1 and y0 < y < y1 and z0 < z < z1) is (name != WORKSPACE):
            return name
    return ""


def is_wall(name: str) -> bool:
    """Whether a solid of a planning scene is one of these limits."""
    return name == WORKSPACE or name.startswith(KEEP_OUT)
