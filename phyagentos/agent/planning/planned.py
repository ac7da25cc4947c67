"""From a goal without a plan to a goal graph with its order and reasons, or to what is missing.

Upstream: an author, or an understander of requests. Downstream: the file that an author would have written, and repair.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from itertools import chain

import yaml

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.selector import find_lacks, find_predicates
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.amount_plans import plan_amounts
from phyagentos.agent.planning.answer_sets import solve
from phyagentos.agent.planning.answers import Missing, PlannedGoal, Step, UnreachableReason, Unsolvable, name_steps
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
from phyagentos.agent.planning.recipe_domain import is_of_amounts
from phyagentos.protocol.documents.flowchart import Arrow, Box, render_flowchart
from phyagentos.protocol.predicates.meaning import find_held
from phyagentos.protocol.world.environment import Environment


def plan_goal(
    wanted: WantedGoal,
    catalogue: Catalogue,
    world: Environment,
    without: Collection[Tried] = (),
    may_hold: bool = True,
    solve: Callable[[PlanningProblem], Plan | ProvenUnsolvable | None] = solve,
) -> PlannedGoal | Unsolvable:
    """Plan a goal from a snapshot, or the start of a scene, `without` sessions that were tried in vain.

    Without `may_hold` a plan puts down what it takes, unless the goal wants it in the hand, or there is no place. What
    `solve` answers has to be a plan of its problem.

    Raises:
        DefinitionError: A predicate cannot be parsed or planned for, or a target is unknown.
    """
    if is_of_amounts(wanted):
        return plan_amounts(wanted, catalogue, world, without)
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
    head |= {"budget": budget} if (budget := wanted.budget.model_dump(exclude_none=True)) else {}
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
    names = name_steps((each.skill, each.parameters) for each in plan.operators)
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
