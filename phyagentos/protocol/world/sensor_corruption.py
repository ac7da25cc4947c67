"""Corruption of sensor data, as data: part of the fault file (`protocol.world.faults`).

Upstream: a fault file. Downstream: the world's fault injector and its cameras.
"""

from typing import Literal

import pydantic

from phyagentos.protocol.documents.schema import Authored

Number3 = tuple[float, float, float]
ALWAYS_S = 3600.0  # longer than any episode


class When(Authored):
    """Conditions on simulated state; all that are given must hold.

    Attributes:
        time_s: The episode is at least this old [s].
        session: Pattern of the running session's name (`*.red`, `*`).
        lifted_m: The object is held, and this far above where it stood when the session began [m].
        gripper_near_m: The tool centre point is at most this far from the object [m].
    """

    time_s: float | None = None
    session: str | None = None
    lifted_m: float | None = None
    gripper_near_m: float | None = None


class CameraFault(Authored):
    """What faults of cameras have in common.

    Attributes:
        camera: Name of a camera in sensors.yaml, or a pattern (`*`).
        object: That `when` speaks of; needed for `lifted_m` and `gripper_near_m` only.
        when: Its conditions.
        duration_s: How long it lasts [s].
    """

    camera: str = "*"
    object: str = ""
    when: When = When()
    duration_s: float = pydantic.Field(default=ALWAYS_S, gt=0.0)

    @pydantic.model_validator(mode="after")
    def _check_object(self) -> "CameraFault":
        if not self.object and (self.when.lifted_m is not None or self.when.gripper_near_m is not None):
            raise ValueError("lifted_m and gripper_near_m need an object")
        return self


class Freeze(CameraFault):
    """A camera repeats its last frame, noise and all.

    Attributes:
        stamp: `fresh` stamps an old frame with the present time; `stale` keeps its exposure time.
    """

    kind: Literal["freeze"]
    stamp: Literal["fresh", "stale"] = "fresh"


class Blackout(CameraFault):
    """A camera sees nothing.

    Attributes:
        mode: `dark` gives black frames without depth; `silent` gives none.
    """

    kind: Literal["blackout"]
    mode: Literal["dark", "silent"] = "dark"


class Misdate(CameraFault):
    """A camera's clock is wrong.

    Attributes:
        by_s: Added to the time of its frames; negative makes them seem older than they are [s].
    """

    kind: Literal["misdate"]
    by_s: float = pydantic.Field(default=-5.0, ge=-1000.0, le=1000.0)


class Miscalibrate(CameraFault):
    """A camera was bumped: it reports its former pose.

    Attributes:
        by_m: (3,) offset of the reported position from the true one, in the camera's frame [m].
        by_rad: (3,) and how it is turned: an axis by its angle [rad].
    """

    kind: Literal["miscalibrate"]
    by_m: Number3 = (0.03, 0.0, 0.0)
    by_rad: Number3 = (0.0, 0.0, 0.0)
