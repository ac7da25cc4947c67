"""What a leaf surely does first, as the wiring of its tree says it: what is tried before anything moves."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from phyagentos.protocol.capabilities.skill_runtimes import Parameter, find_mismatch
from phyagentos.protocol.predicates.meaning import find_relation
from phyagentos.protocol.sessions.trace import STILL, Role
from phyagentos.runtime.motion.requests import Destination

_POINT = Parameter(type="point")
_PASSED_OVER = STILL | {Role.MOVE}  # between grasp and place they move nothing but what is held


@dataclass(frozen=True, slots=True)
class Home:
    """The tree goes to the home posture, or to a named one, before anything has been grasped."""

    posture: str = "home"


@dataclass(frozen=True, slots=True)
class Grasp:
    """The tree grasps an object, before anything has moved; `then` is where it says that it puts it.

    If it moves out of there what is in the way, that may be anything `removable`; None where it moves nothing out.
    `leaf` is the path of the leaf that asks for the grasp: the planner keeps its answer for it.
    """

    object: str
    leaf: str
    then: Destination | None = None
    removable: tuple[str, ...] | None = None


FirstMotion = Home | Grasp | Destination
"""A destination is where the tree puts down what it grasped."""


class Onward(StrEnum):
    """How sure what follows a leaf is."""

    SURE = "sure"
    """As sure as the leaf."""
    OUTSIDE = "outside"
    """The rest of its own tree moves only what the leaf finds in the way; what follows that tree is as sure."""
    OPEN = "open"
    """Nothing is known of it."""


@dataclass(frozen=True, slots=True)
class Foreseen:
    """The motion that a leaf begins, None where it begins none, and what follows."""

    motion: FirstMotion | None = None
    onward: Onward = Onward.SURE


def foresee_by_role(role: Role, wired: Mapping[str, Any], path: str) -> Foreseen:
    """What a leaf of a role does first, by the ports that are named with the role; `wired` holds what is known."""
    object, to = wired.get("object"), make_destination(wired)
    match role:
        case Role.HOME:
            return Foreseen(Home(wired.get("posture") or "home"))
        case Role.PLAN_GRASP if isinstance(object, str):
            return Foreseen(Grasp(object, path, to))
        case Role.PLAN_ROOM if isinstance(object, str):
            return Foreseen(None if to is None else Grasp(object, path, to, removable=()), Onward.OUTSIDE)
        case Role.PLAN_SITE if to is not None:
            return Foreseen(to, Onward.OPEN)
    return Foreseen(onward=Onward.SURE if role in _PASSED_OVER else Onward.OPEN)


def make_destination(wired: Mapping[str, Any]) -> Destination | None:
    """Where a leaf puts something; None where it says no place, or a point that is none."""
    name, near = wired.get("destination"), wired.get("near")
    if not isinstance(name, str) or (near is not None and find_mismatch(_POINT, near)):
        return None  # what is no point is reported with the arguments
    return Destination(
        name,
        find_relation(str(wired.get("relation") or "")),
        near=None if near is None else (float(near[0]), float(near[1]), float(near[2])),
    )
