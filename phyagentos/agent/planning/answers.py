"""What planning answers: a goal with the sessions that reach it, or what it lacks."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.problem import Fact


class UnreachableReason(StrEnum):
    """Why a goal cannot be reached."""

    PREDICATE = "predicate"
    """No skill guarantees it."""
    CAPABILITY = "capability"
    """A skill guarantees it, and no target of the goal offers what that needs."""
    ARGUMENT = "argument"
    """Skills guarantee it of other objects or places: what it names does not fit, or is not here."""
    PRECONDITION = "precondition"
    """Skills guarantee it, and what they need first cannot come true."""
    ROOM = "room"
    """It needs more free room than there is."""
    CONSTRAINT = "constraint"
    """A constraint forbids every plan."""
    CONTRADICTION = "contradiction"
    """Its parts and their order exclude each other."""
    AMOUNT = "amount"
    """It needs more of something than there is, and than can be made."""
    MODEL = "model"
    """The answers of a model were no plan."""
    TIME = "time"
    """No plan was found within the planner's limits; there may be one."""


@dataclass(frozen=True, slots=True)
class Missing:
    """A lack of a goal, or one predicate of it; `names` are skills, predicates or places, by `lack`."""

    lack: UnreachableReason
    subject: Fact = ""
    names: tuple[str, ...] = ()

    def describe(self) -> str:
        """For people."""
        return _TEXTS[self.lack].format(self.subject, ", ".join(self.names))


_TEXTS = {
    UnreachableReason.PREDICATE: "{0}: no skill guarantees it",
    UnreachableReason.CAPABILITY: "{0}: {1}",
    UnreachableReason.ARGUMENT: "{0}: {1} cannot be used for what it names",
    UnreachableReason.PRECONDITION: "{0}: it needs {1} first, which cannot come true",
    UnreachableReason.ROOM: "no free spot in {1}",
    UnreachableReason.CONSTRAINT: "{1} forbids every plan",
    UnreachableReason.CONTRADICTION: "these exclude each other, or their order does: {1}",
    UnreachableReason.AMOUNT: "amounts do not suffice; there would have to be {1} more",
    UnreachableReason.MODEL: "the last answer of the model was no plan: {1}",
    UnreachableReason.TIME: "no plan was found within the planner's limits",
}


@dataclass(frozen=True, slots=True)
class Unsolvable:
    """What a goal lacks; `is_proven` is false where there may be a plan nevertheless."""

    missing: tuple[Missing, ...]
    is_proven: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One session of a plan, `after` those directly before it; it accepts what it brings about of the goal."""

    name: str
    skill: str
    target: str
    parameters: Mapping[str, Any]
    after: tuple[str, ...]
    accept: tuple[str, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedGoal:
    """A goal and its plan, whose order reaches it; without steps where it is met already. `roles`: role -> target."""

    wanted: WantedGoal
    roles: Mapping[str, str]
    steps: tuple[Step, ...]


def name_steps(sessions: Iterable[tuple[str, Mapping[str, object]]]) -> list[str]:
    """A name for each skill with its parameters: after the first object, item or place that these name."""
    names: list[str] = []
    for skill, parameters in sessions:
        first = next((value for value in parameters.values() if isinstance(value, str)), "")
        name = "_".join(filter(None, (skill, first.lower())))[:70]
        names.append(name if name not in names else f"{name}_{sum(each.startswith(name) for each in names) + 1}")
    return names
