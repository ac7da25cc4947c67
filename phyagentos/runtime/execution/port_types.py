"""The types of ports, by the names that trees and skills use."""

from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.motion.requests import Approach, Approaches, Payload


class Names(tuple[str, ...]):
    """Value of a port of type `entities`."""


class Points(tuple[tuple[float, ...], ...]):
    """Value of a port of type `points`."""


PORT_TYPES: dict[str, type] = {  # type names of trees and skills
    "entity": str,
    "entities": Names,
    "place": str,
    "point": tuple,
    "points": Points,
    "posture": str,
    "number": float,
    "integer": int,
    "string": str,
    "boolean": bool,
    "pose": Pose,
    "approach": Approach,
    "approaches": Approaches,
    "payload": Payload,
}

ELEMENTS: dict[type, type] = {Names: str, Points: tuple}  # what a list gives to `for_each`
EXPORTED_TYPES = frozenset(PORT_TYPES) - {"approach", "approaches", "payload"}  # what a contract can carry
