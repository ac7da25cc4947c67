"""Where the tool centre point may be, as planning sees it: solids that a small ball about it must not meet.

The numbers are those of safety.yaml. The guard shares no code with this and enforces them on every command.
"""

from collections.abc import Iterator

import msgspec
import numpy as np

from phyagentos.protocol.settings.safety import Limit, TargetLimits
from phyagentos.runtime.motion.requests import Array

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]

BALL_M = 0.01  # its radius: a measured tool is beside the planned one by tracking and by the noise of its encoders
WALL_M = 10.0  # half thickness of what surrounds the workspace: no arm reaches through it
WORKSPACE, KEEP_OUT = "workspace_box", "keep_out."


class Room(msgspec.Struct, frozen=True):
    """Limits of the tool centre point; boxes by their least and greatest corner, world frame [m].

    Attributes:
        workspace: It stays inside; None where nothing bounds it.
        keep_out: It stays outside of each, by name.
    """

    workspace: Corners | None = None
    keep_out: dict[str, Corners] = {}

    @classmethod
    def of(cls, limits: TargetLimits) -> "Room":
        """The room that safety.yaml leaves a target."""
        keep_out = {name: _read_corners(limit) for name, limit in limits.keep_out.items()}
        return cls(_read_corners(limits.workspace_box), keep_out)

    def iter_walls(self) -> Iterator[tuple[str, Array, Array]]:
        """Boxes that the ball must not meet: `workspace_box` or `keep_out.<name>`, centre (3,), half extents (3,)."""
        for axis in range(3) if self.workspace is not None else ():
            for corner, side in zip(np.array(self.workspace), (-1.0, 1.0), strict=True):
                center = np.zeros(3)
                center[axis] = corner[axis] + side * WALL_M
                yield WORKSPACE, center, np.full(3, WALL_M)
        for name, corners in self.keep_out.items():
            low, high = np.array(corners)
            yield f"{KEEP_OUT}{name}", (low + high) / 2.0, (high - low) / 2.0


UNBOUNDED = Room()


def is_wall(name: str) -> bool:
    """Whether a solid of a planning scene is one of these limits."""
    return name == WORKSPACE or name.startswith(KEEP_OUT)


def _read_corners(limit: Limit) -> Corners:
    (a, b, c), (x, y, z) = np.asarray(limit.value, dtype=np.float64).tolist()
    return (a, b, c), (x, y, z)
