"""Faults of a simulated world, as data: the world process reads them, the agent never does."""

from pathlib import Path
from typing import Annotated, Literal

import pydantic

from phyagentos.protocol.documents.schema import Authored, read_yaml, validate
from phyagentos.protocol.world.body_shapes import Number3

ALWAYS_S = 3600.0  # longer than any episode


class When(Authored):
    """Conditions on simulated state; all that are given must hold.

    Attributes:
        time_s: The episode is at least this old [s].
        session: Pattern of the running session's name (`*.red`, `*`).
        lifted_m: The object is held, and this far above where it stood when the session began [m].
        gripper_near_m: The tool centre point is at most this far from the object [m].
    """

    time_s: float | None = pydantic.Field(default=None, ge=0.0)
    session: str | None = None
    lifted_m: float | None = pydantic.Field(default=None, ge=0.0, le=5.0)
    gripper_near_m: float | None = pydantic.Field(default=None, ge=0.0)


class Slip(Authored):
    """The fingers lose their friction for a while, so that what they hold falls."""

    kind: Literal["slip"]
    object: str
    when: When = When(lifted_m=0.12)
    duration_s: float = pydantic.Field(default=0.5, gt=0.0)


class Nudge(Authored):
    """Something knocks the object aside, along the table, just before the gripper closes."""

    kind: Literal["nudge"]
    object: str
    when: When = When(gripper_near_m=0.04)
    by_m: float = pydantic.Field(default=0.06, gt=0.0, le=0.3)
    duration_s: float = pydantic.Field(default=0.25, gt=0.0)


class Move(Authored):
    """A person takes the object and puts it down elsewhere.

    Attributes:
        to_m: Where to, x and y in the world; drawn near its place when absent.
    """

    kind: Literal["move"]
    object: str
    when: When = When(gripper_near_m=0.25)
    to_m: tuple[float, float] | None = None
    duration_s: float = pydantic.Field(default=1.0, gt=0.0)


class Remove(Authored):
    """A person takes the object away, off the table, out of reach."""

    kind: Literal["remove"]
    object: str
    when: When = When(gripper_near_m=0.25)
    to_m: tuple[float, float] = (1.6, -0.6)
    duration_s: float = pydantic.Field(default=1.2, gt=0.0)


class Stall(Authored):
    """A motor seizes for a while: its joint does not turn whatever is commanded."""

    kind: Literal["stall"]
    joint: str = "joint2"
    object: str = ""
    when: When = When(gripper_near_m=0.3)
    duration_s: float = pydantic.Field(default=1.5, gt=0.0)


class Push(Authored):
    """Something pushes a link of the robot, level, at its centre of mass.

    Attributes:
        joint: Whose link it is.
        force_n: The force [N].
        direction_rad: Where to, from the world's x axis [rad]; drawn when absent.
    """

    kind: Literal["push"]
    joint: str
    object: str = ""
    when: When = When()
    force_n: float = pydantic.Field(default=20.0, gt=0.0, le=500.0)
    direction_rad: float | None = None
    duration_s: float = pydantic.Field(default=0.5, gt=0.0)


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


PhysicalFault = Slip | Nudge | Move | Remove | Stall | Push
SensorFault = Freeze | Blackout | Misdate | Miscalibrate
Fault = Annotated[PhysicalFault | SensorFault, pydantic.Field(discriminator="kind")]


class Draw(Authored):
    """One fault for the whole episode, drawn by the episode's seed: a kind, and an object."""

    one_of: tuple[Literal["slip", "nudge", "move", "stall"], ...]
    objects: tuple[str, ...] = pydantic.Field(min_length=1)


class FaultFile(Authored):
    """One fault file."""

    version: Literal[1]
    description: str = ""
    faults: tuple[Fault, ...] = ()
    draw: Draw | None = None


def read_faults(path: Path) -> FaultFile:
    """Read a fault file; raises DefinitionError with every problem at file:line:column."""
    return validate(FaultFile, read_yaml(path))
