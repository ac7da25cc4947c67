"""From a goal without a plan to a goal graph with its order and reasons, or to what is missing.

Upstream: an author, or an understander of requests. Downstream: the file that an author would have written, and repair.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import chain
from typing import Any

import yaml

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.selector import find_lacks, find_predicates
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.answer_sets import solve
from phyagentos.agent.planning.domain import Domain, Tried, build_domain
from phyagentos.agent.planning.problem import (
    Condition,
    Fact,
    Plan,
    PlanningProblem,
    ProvenUnsolvable,
    find_causal_links,
    iter_states,
    order_steps,
)
from phyagentos.protocol.documents.flowchart import Arrow, Box, render_flowchart
from phyagentos.protocol.predicates.meaning import find_held
from phyagentos.protocol.world.environment import Environment


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


def plan_goal(
    wanted: WantedGoal,
    catalogue: Catalogue,
    world: Environment,
    without: Collection[Tried] = (),
    may_hold: bool = True,
) -> PlannedGoal | Unsolvable:
    """Plan a goal from a snapshot, or the start of a scene, `without` sessions that were tried in vain.

    Without `may_hold` a plan puts down what it takes, unless the goal wants it in the hand, or there is no place.

    Raises:
        DefinitionError: A predicate cannot be parsed or planned for, or a target is unknown.
    """
    for everywhere in (False, True):  # objects may also go where the goal names no place
        domain = build_domain(wanted, catalogue, world, everywhere=everywhere, without=without)
        answer = solve(domain.problem)
        if not may_hold and isinstance(answer, Plan) and (held := _list_held(domain.problem, answer)):
            *before, last = domain.problem.stages
            empty = (*last, *(Condition(((fact, False),), 1, 1) for fact in held))
            emptied = solve(replace(domain.problem, stages=(*before, empty)))
            answer = emptied if not everywhere or isinstance(emptied, Plan) else answer
        if isinstance(answer, Plan):
            steps = tuple(_iter_steps(answer, domain.problem, domain.roles))
            return PlannedGoal(wanted=wanted, roles=domain.roles, steps=steps)
    if isinstance(answer, ProvenUnsolvable):
        return Unsolvable(tuple(_explain(answer, domain, wanted, catalogue, world)))
    return Unsolvable((Missing(UnreachableReason.TIME),), is_proven=False)


def _list_held(problem: PlanningProblem, plan: Plan) -> list[Fact]:
    """What a plan leaves in a hand that was not there, and that the goal does not want there."""
    *_, end = iter_states(problem, plan)
    wanted = {fact for stage in problem.stages for each in stage for fact, _ in each.literals} | problem.initial
    held = (fact for fact, value in end.items() if value and fact not in wanted)
    return [fact for fact in held if find_held(fact) is not None]


def write_graph(planned: PlannedGoal) -> str:
    """The goal graph as an author would have written it, with the reasons above each node; there must be steps."""
    if not planned.steps:
        raise ValueError("a goal that is met already needs no goal graph")
    wanted = planned.wanted
    head = wanted.model_dump(include={"goal", "objective", "scene"}) | {"targets": dict(planned.roles)}
    head |= {"constraints": list(wanted.constraints)} if wanted.constraints else {}
    head |= {"defaults": {"timeout_s": 60, "max_replans": 2}}
    lines = ["# Planned by effects from the world as it stood; `paos plan` shows the reasons again.\n"]
    lines += [_dump(head), "sessions:\n"]
    for step in planned.steps:
        lines += [f"  # {reason}\n" for reason in step.reasons]
        node: dict[str, object] = {"after": list(step.after)} if step.after else {}
        node |= {"skill": step.skill, "target": step.target, "with": dict(step.parameters)}
        node |= {"accept": list(step.accept)} if step.accept else {}
        lines += [f"  {line}\n" for line in _dump({step.name: node}).splitlines()]
    return "".join([*lines, _dump({"accept": list(wanted.accept)})])


def _dump(data: dict[str, object]) -> str:
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=1000)


def render_mermaid(planned: PlannedGoal) -> str:
    """The partial order as a Mermaid flowchart."""
    boxes = [Box(name=step.name, title=step.name, below=[f"{step.skill} on {step.target}"]) for step in planned.steps]
    arrows = [Arrow(before, step.name) for step in planned.steps for before in step.after]
    return render_flowchart(boxes, arrows, direction="LR")


def _iter_steps(plan: Plan, problem: PlanningProblem, roles: Mapping[str, str]) -> Iterator[Step]:
    names = _name_steps(plan)
    links, dag = find_causal_links(problem, plan), order_steps(problem, plan)
    role_of = {target: role for role, target in reversed(list(roles.items()))}
    conditions = [*chain(*problem.stages)]
    parts = Counter(each.text for each in conditions)  # what holds in parts is not accepted as a whole by one step
    authored = {each.literals[0]: each.text for each in conditions if len(each.literals) == parts[each.text] == 1}
    for index, operator in enumerate(plan.operators):
        made = [((link.fact, link.value), link.needed_by) for link in links if link.made_by == index]
        wants = dict.fromkeys(literal for literal, needed_by in made if needed_by is None)
        needs = dict.fromkeys(
            f"brings about {_render(*literal)}, which {names[needed_by]} needs"
            for literal, needed_by in made
            if needed_by is not None and literal not in wants
        )
        wanted = (f"brings about {_render(*literal)}, which the goal wants" for literal in wants)
        yield Step(
            name=names[index],
            skill=operator.skill,
            target=role_of[operator.target],
            parameters=operator.parameters,
            after=tuple(names[before] for before in sorted(dag.pred[index])),
            accept=tuple(dict.fromkeys(authored[literal] for literal in wants if literal in authored)),
            reasons=(operator.reason, *wanted, *needs),
        )


def _render(fact: Fact, value: bool) -> str:
    return fact if value else f"not {fact}"


def _name_steps(plan: Plan) -> list[str]:
    names: list[str] = []
    for operator in plan.operators:
        thing = next((value for value in operator.parameters.values() if isinstance(value, str)), "")
        name = "_".join(filter(None, (operator.skill, thing.lower())))[:70]
        names.append(name if name not in names else f"{name}_{sum(each.startswith(name) for each in names) + 1}")
    return names


def _explain(
    proof: ProvenUnsolvable,
    domain: Domain,
    wanted: WantedGoal,
    catalogue: Catalogue,
    world: Environment,
) -> Iterator[Missing]:
    if wanted.constraints:
        free = build_domain(wanted.model_copy(update={"constraints": ()}), catalogue, world, everywhere=True)
        if isinstance(solve(free.problem), Plan):
            yield Missing(UnreachableReason.CONSTRAINT, names=wanted.constraints)
            return
    if proof.unreachable:
        yield from (_explain_fact(fact, domain, catalogue) for fact in proof.unreachable)
    elif isinstance(roomy := solve(replace(domain.problem, capacities=())), Plan):
        yield Missing(UnreachableReason.ROOM, names=tuple(_iter_overfull(roomy, domain.problem)))
    else:
        yield Missing(UnreachableReason.CONTRADICTION, names=(*chain(*wanted.steps), *wanted.accept))


def _explain_fact(fact: Fact, domain: Domain, catalogue: Catalogue) -> Missing:
    value = fact not in domain.problem.initial
    makers = [each for each in domain.problem.operators if each.changes.get(fact) is value]
    if makers:  # what these need, and nothing brings about
        made = {change for each in domain.problem.operators for change in each.changes.items()} | domain.state
        needs = dict.fromkeys(literal for each in makers for literal in each.requires.items())
        unreachable = tuple(_render(*literal) for literal in needs if literal not in made)
        return Missing(UnreachableReason.PRECONDITION, _render(fact, value), unreachable)
    wanted = find_predicates([fact])
    skills = [skill for skill in catalogue.skills.values() if wanted <= find_predicates(skill.guarantees)]
    if not skills:
        return Missing(UnreachableReason.PREDICATE, fact)
    profiles = [catalogue.targets[name] for name in domain.roles.values()]
    lacks = [(s.skill, p.target, [*find_lacks(s, p)]) for s in skills for p in profiles]
    skill, target, least = min(lacks, key=lambda each: len(each[2]))
    if least:
        return Missing(
            UnreachableReason.CAPABILITY, fact, tuple(f"{target} lacks {lack} for {skill}" for lack in least)
        )
    return Missing(UnreachableReason.ARGUMENT, fact, tuple(sorted(skill.skill for skill in skills)))


def _iter_overfull(plan: Plan, problem: PlanningProblem) -> Iterator[str]:
    """Places that a plan overfills."""
    states = [*iter_states(problem, plan)]
    for capacity in problem.capacities:
        loads = (sum(weight for fact, weight in capacity.weights.items() if state.get(fact)) for state in states)
        if max(loads) > capacity.most:
            yield capacity.place
