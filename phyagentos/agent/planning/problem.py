"""The port of planners: facts that operators make true or false, and what they answer.

Upstream: the domain of a goal. Downstream: an engine. A fact is the canonical text of a predicate; what is not stated
true is false. Alternative: PDDL with unified-planning, whose complete engines are GPL or weigh over 200 MB.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

Fact = str


@dataclass(frozen=True, slots=True, kw_only=True)
class Operator:
    """One skill with its arguments, as it changes facts.

    Attributes:
        name: Unique.
        parameters: Arguments of the skill.
        requires: Fact -> whether it must be true, or false, before.
        changes: Fact -> whether it is true afterwards; all others stay.
        cost: Plans with the least sum are preferred; at least 1.
        reasons: One sentence each, for people.
    """

    name: str
    skill: str
    target: str
    parameters: Mapping[str, Any]
    requires: Mapping[Fact, bool]
    changes: Mapping[Fact, bool]
    cost: int = 1
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Condition:
    """So many of some literals, each a fact and the value that counts; one of one is a plain condition.

    Attributes:
        text: As authored.
    """

    literals: tuple[tuple[Fact, bool], ...]
    least: int
    most: int
    text: str = ""


@dataclass(frozen=True, slots=True)
class Capacity:
    """What fills a place: the weights of its true facts never sum to more."""

    place: str
    weights: Mapping[Fact, int]
    most: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningProblem:
    """From a state to a goal.

    Attributes:
        initial: Facts that are true.
        stages: Each comes true before the next one does; the last one holds at the end.
        exclusive: Groups of facts of which at most one is ever true.
        exact: Those of them of which one is always true.
    """

    operators: tuple[Operator, ...]
    initial: frozenset[Fact]
    stages: tuple[tuple[Condition, ...], ...]
    capacities: tuple[Capacity, ...] = ()
    exclusive: tuple[frozenset[Fact], ...] = ()
    exact: tuple[frozenset[Fact], ...] = ()


@dataclass(frozen=True, slots=True)
class Plan:
    """Operators in an order that reaches the goal.

    Attributes:
        reached: Stage -> how many operators come before it is reached.
    """

    operators: tuple[Operator, ...]
    reached: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class ProvenUnsolvable:
    """No sequence of operators reaches the goal.

    Attributes:
        unreachable: Facts of the goal that no sequence brings about even if nothing were ever undone; empty where only
            their combination is impossible.
    """

    unreachable: tuple[Fact, ...] = field(default=())


@dataclass(frozen=True, slots=True)
class NotFound:
    """The limits of the engine were met first.

    Attributes:
        steps: No plan has fewer rounds of independent operators.
    """

    steps: int


class Planner(Protocol):
    """Solves problems; the same problem has the same answer."""

    def solve(self, problem: PlanningProblem) -> Plan | ProvenUnsolvable | NotFound:
        """A plan, a proof that there is none, or neither within the engine's limits."""
        ...
