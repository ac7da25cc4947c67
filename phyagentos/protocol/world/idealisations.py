"""What of a target and its world is simpler than reality, by choice of a scene, a profile or a setting."""

from collections.abc import Iterable
from enum import StrEnum

import msgspec


class Aspect(StrEnum):
    """What is idealised."""

    PHYSICS = "physics"
    """There is none."""
    FRICTION = "friction"
    """Bodies or pads without a surface: their friction is the same against everything."""
    HAND_MASS = "hand_mass"
    """The hand weighs nothing in the arm's load."""
    JOINT_SENSORS = "joint_sensors"
    """Joints are measured without noise and without delay."""
    CONTACT_FORCE = "contact_force"
    """Contact forces are measured without error."""
    CAMERAS = "cameras"
    """Pictures are perfect, or glass, black surfaces and motion do not spoil them."""


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
