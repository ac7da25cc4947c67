"""What of a target and its world is simpler than reality, by choice of a scene, a profile or a setting."""

from collections.abc import Iterable
from enum import StrEnum

import msgspec


class Aspect(StrEnum):
    """What is idealised.

    There is no physics; friction is the same against everything; the hand weighs nothing; joints or forces are measured
    without error; pictures are perfect, or glass, black surfaces and motion do not spoil them.
    """

    PHYSICS = "physics"
    FRICTION = "friction"
    HAND_MASS = "hand_mass"
    JOINT_SENSORS = "joint_sensors"
    CONTACT_FORCE = "contact_force"
    CAMERAS = "cameras"


class Idealisation(msgspec.Struct, frozen=True):
    """One aspect of a target or its world that is simpler than in reality.

    Attributes:
        aspect: Which one.
        what: What it concerns (`coin`, `noise level none`); empty where that is the whole target.
    """

    aspect: Aspect
    what: str = ""


def format_idealisations(idealisations: Iterable[Idealisation]) -> str:
    """`friction (coin), joint_sensors`; empty where nothing is idealised."""
    return ", ".join(f"{each.aspect} ({each.what})" if each.what else each.aspect for each in idealisations)
