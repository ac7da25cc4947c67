"""A goal without a plan: what must come true, in which order, and what must hold meanwhile. Paper section 3.3.

Upstream: an author, or an understander of requests. Downstream: the planner, which makes a goal graph of it.
"""

from typing import Literal

import pydantic

from phyagentos.agent.goals.spec import NODE_NAME
from phyagentos.protocol.documents.schema import Authored


class WantedGoal(Authored):
    """A goal as predicates; it has the keys of a goal graph that say what is wanted, and no sessions.

    Attributes:
        goal: Name, as of a goal graph.
        objective: In words.
        scene: Name of the scene.
        targets: Role -> name in TARGETS.md, or `any`.
        constraints: Invariants, sampled all through every session.
        steps: What must come true before what follows it, in this order; each a list of predicates that hold together.
        accept: What must be true at the end.
    """

    version: Literal[1] = 1
    goal: str = pydantic.Field(pattern=NODE_NAME)
    objective: str
    scene: str
    targets: dict[str, str] = {}
    constraints: tuple[str, ...] = ()
    steps: tuple[tuple[str, ...], ...] = ()
    accept: tuple[str, ...] = pydantic.Field(min_length=1)


def is_wanted(data: object) -> bool:
    """Whether a YAML mapping is a goal without a plan, which has `accept`; a goal graph has `sessions`."""
    return isinstance(data, dict) and {"goal", "accept"} <= data.keys() and "sessions" not in data
