"""Type names of trees and skills, as the Python types that ports carry."""

from typing import Any

from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.motion.requests import Approach, Approaches, Payload

PORT_TYPES: dict[str, type] = {
    "entity": str,
    "place": str,
    "point": tuple,
    "number": float,
    "integer": int,
    "string": str,
    "boolean": bool,
    "pose": Pose,
    "approach": Approach,
    "approaches": Approaches,
    "payload": Payload,
}

EXPORTED_TYPES = frozenset(PORT_TYPES) - {"approach", "approaches", "payload"}  # what a contract can carry


def convert_literal(value: Any, kind: type) -> Any:
    """A value from YAML as a port takes it: whole numbers pass as numbers, lists as tuples.

    Raises:
        TypeError: When it is of another type.
    """
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if kind is tuple and isinstance(value, list):
        return tuple(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise TypeError(f"{value!r} is not of type {kind.__name__}")
    return value


def export_value(value: Any) -> Any:
    """An output as plain data for a contract: a pose as seven numbers, a tuple as a list."""
    if isinstance(value, Pose):
        return [*value.position_m, *value.quaternion_wxyz]
    if isinstance(value, tuple):
        return list(value)
    return value
