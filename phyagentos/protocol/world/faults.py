"""Faults of a simulated world, as data: the world process reads them, the agent never does."""

from pathlib import Path
from typing import Annotated, Literal

import pydantic

from phyagentos.protocol.documents.schema import Authored, read_yaml, validate
from phyagentos.protocol.world.sensor_corruption import Blackout, Freeze, Miscalibrate, Misdate, When

Number2 = tuple[float, float]


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
    to_m: Number2 | None = None
    duration_s: float = pydantic.Field(default=1.0, gt=0.0)


class Remove(Authored):
    """A person takes the object away, off the table, out of reach."""

    kind: Literal["remove"]
    object: str
    when: When = When(gripper_near_m=0.25)
    to_m: Number2 = (1.6, -0.6)
    duration_s: float = pydantic.Field(default=1.2, gt=0.0)


class Stall(Authored):
    """A motor seizes for a while: its joint does not turn whatever is commanded."""

    kind: Literal["stall"]
    joint: str = "joint2"
    object: str = ""
    when: When = When(gripper_near_m=0.3)
    duration_s: float = pydantic.Field(default=1.5, gt=0.0)


PhysicalFault = Slip | Nudge | Move | Remove | Stall
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
    """Read a fault file.

    Raises:
        DefinitionError: With every problem.
    """
    return validate(FaultFile, read_yaml(path))
