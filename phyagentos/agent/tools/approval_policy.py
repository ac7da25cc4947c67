"""A policy file of the operator: which proposals may run without a person, and within which bounds."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import pydantic

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.errors import Problem, format_names
from phyagentos.protocol.documents.schema import Authored

_TIME = r"^([01]\d|2[0-3]):[0-5]\d$"


class PolicyBudget(Authored):
    """What permitted goals may cost.

    Attributes:
        goals_a_day: Approvals by this policy within 24 hours.
        sessions: Most that the `budget` of a goal graph may name; one that names none is not permitted.
        sim_time_s: The same for the simulated time of all executions of a goal [s].
    """

    goals_a_day: int = pydantic.Field(ge=1)
    sessions: int = pydantic.Field(ge=1)
    sim_time_s: float = pydantic.Field(gt=0)


class ApprovalPolicy(Authored):
    """What may run without a person, in any scene when none is named; a span of time may cross midnight."""

    approve: Literal[1] = 1
    skills: tuple[str, ...] = pydantic.Field(min_length=1)
    targets: tuple[str, ...] = pydantic.Field(min_length=1)
    scenes: tuple[str, ...] = ()
    from_utc: str = pydantic.Field(default="00:00", pattern=_TIME)
    until_utc: str = pydantic.Field(default="23:59", pattern=_TIME)
    budget: PolicyBudget


def iter_objections(policy: ApprovalPolicy, graph: GoalGraph, *, at: str, approved: int) -> Iterator[Problem]:
    """Why a goal graph is not permitted, at a wall time of `Clock.wall_iso`; none when it is.

    `approved` is the number of goals that this policy approved within the 24 hours before.
    """
    now, begin, end, budget = at[11:16], policy.from_utc, policy.until_utc, graph.spec.budget
    is_time = begin <= now <= end if begin <= end else now >= begin or now <= end
    most_of = policy.budget
    asked: list[tuple[str, object, bool, str]] = [
        ("scene", graph.spec.scene, graph.spec.scene in (policy.scenes or (graph.spec.scene,)), f"{policy.scenes}"),
        ("time", f"{now} UTC", is_time, f"{begin} to {end} UTC"),
        ("goals", f"{approved} within a day", approved < most_of.goals_a_day, f"at most {most_of.goals_a_day}"),
    ]
    for node, choice in graph.choices.items():
        asked.append((f"{node}.skill", choice.skill, choice.skill in policy.skills, format_names(policy.skills)))
        asked.append((f"{node}.target", choice.target, choice.target in policy.targets, format_names(policy.targets)))
    for name in ("sessions", "sim_time_s"):
        wanted, most = getattr(budget, name), getattr(most_of, name)
        asked.append((f"budget.{name}", wanted, wanted is not None and wanted <= most, f"at most {most}"))
    return (
        Problem("NOT_PERMITTED", f"{graph.name}: {where}", str(found), expected)
        for where, found, is_permitted, expected in asked
        if not is_permitted
    )


def restrict(policy: ApprovalPolicy, catalogue: Catalogue) -> Catalogue:
    """What the policy permits of a catalogue."""
    return replace(
        catalogue,
        skills={name: each for name, each in catalogue.skills.items() if name in policy.skills},
        targets={name: each for name, each in catalogue.targets.items() if name in policy.targets},
    )
