"""Goals about amounts: their sessions in an order that reaches them, or what is short.

Each session says how much there is of what it makes once it is done, so that one that was begun can go on. Of two
sessions the order is fixed where one makes what the other one uses or needs; several that only use it have none.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from itertools import combinations, starmap

import networkx as nx

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.amounts import (
    Activity,
    AmountPlan,
    AmountProblem,
    Batch,
    Resource,
    Shortage,
    find_reachable,
    iter_amounts,
)
from phyagentos.agent.planning.answers import Missing, PlannedGoal, Step, UnreachableReason, Unsolvable, name_steps
from phyagentos.agent.planning.domain import Tried
from phyagentos.agent.planning.integer_program import solve
from phyagentos.agent.planning.recipe_domain import RecipeDomain, build_recipe_domain
from phyagentos.protocol.world.environment import Environment


def plan_amounts(
    wanted: WantedGoal, catalogue: Catalogue, world: Environment, without: Collection[Tried] = ()
) -> PlannedGoal | Unsolvable:
    """Plan a goal about amounts from a snapshot; raises as `build_recipe_domain`."""
    domain = build_recipe_domain(wanted, catalogue, world, without)
    answer = solve(domain.problem)
    if isinstance(answer, AmountPlan):
        return PlannedGoal(wanted=wanted, roles=domain.roles, steps=tuple(_iter_steps(answer, domain)))
    if isinstance(answer, Shortage):
        return Unsolvable(tuple(_explain(answer, domain.problem, wanted)))
    return Unsolvable((Missing(UnreachableReason.TIME),), is_proven=False)


def order_batches(plan: AmountPlan) -> "nx.DiGraph[int]":
    """The batches of a plan by their index; every order that the graph allows has the same amounts after each."""
    dag: nx.DiGraph[int] = nx.DiGraph()
    dag.add_nodes_from(range(len(plan.batches)))
    pairs = combinations(enumerate(each.activity for each in plan.batches), 2)
    dag.add_edges_from((i, j) for (i, one), (j, other) in pairs if _depends(one, other) or _depends(other, one))
    for border in plan.reached:
        dag.add_edges_from((i, j) for i in range(border) for j in range(border, len(plan.batches)))
    return nx.transitive_reduction(dag)


def _depends(one: Activity, other: Activity) -> bool:
    """Whether one makes what another one makes, uses or needs, or uses what that needs to stay."""
    touched = other.makes.keys() | other.uses.keys() | other.needs.keys()
    return not one.makes.keys().isdisjoint(touched) or not one.uses.keys().isdisjoint(other.needs)


def _iter_steps(plan: AmountPlan, domain: RecipeDomain) -> Iterator[Step]:
    dag, problem = order_batches(plan), domain.problem
    after = [*iter_amounts(problem, plan.batches)][1:]
    parameters = [_fill(each.activity, state, problem) for each, state in zip(plan.batches, after, strict=True)]
    names = name_steps((each.activity.skill, given) for each, given in zip(plan.batches, parameters, strict=True))
    role_of = {target: role for role, target in reversed(list(domain.roles.items()))}
    for index, batch in enumerate(plan.batches):
        uses = [
            names[later]
            for later in nx.descendants(dag, index)
            if _depends(batch.activity, plan.batches[later].activity)
        ]
        accept = tuple(_iter_accepted(index, plan, domain))
        needed = [f"is needed by {', '.join(sorted(uses))}"] if uses else []
        yield Step(
            name=names[index],
            skill=batch.activity.skill,
            target=role_of[batch.activity.target],
            parameters=parameters[index],
            after=tuple(names[before] for before in sorted(dag.pred[index])),
            accept=accept,
            reasons=(
                _describe(batch, problem),
                *(f"brings about {text}, which the goal wants" for text in accept),
                *needed,
            ),
        )


def _fill(activity: Activity, state: Mapping[Resource, float], problem: AmountProblem) -> dict[str, object]:
    """The parameters of a session after which the state is so."""
    amount = math.ceil(state[activity.made] / problem.units.get(activity.made, 1))
    return {**activity.parameters, **({activity.counter: amount} if activity.counter else {})}


def _iter_accepted(index: int, plan: AmountPlan, domain: RecipeDomain) -> Iterator[str]:
    """Predicates of the goal that are met once a session is done, which is the last one to make what they are about."""
    begin = 0
    for stage, end in zip(domain.texts, plan.reached, strict=True):
        for text, bounds in stage.items() if begin <= index < end else ():
            makers = [i for i in range(begin, end) if bounds.keys() & plan.batches[i].activity.makes.keys()]
            is_least = all(high == math.inf for _, high in bounds.values())
            if is_least and len(bounds) == 1 and makers and makers[-1] == index:
                yield text
        begin = end


def _describe(batch: Batch, problem: AmountProblem) -> str:
    """`craft makes 4 planks from 1 log, 3 times, in 3 s`."""
    each = batch.activity

    def count(name: Resource, amount: float) -> str:
        unit = problem.units.get(name, 1)
        return f"{amount / unit:g} {name.subject}" if amount >= unit else f"{amount:g} use of {name.subject}"

    made, used = (" and ".join(starmap(count, each.items())) for each in (each.makes, each.uses))
    times = f", {batch.times} times" if batch.times > 1 else ""
    return f"{each.skill} makes {made} from {used or 'nothing'}{times}, in {each.time_s * batch.times:g} s"


def _explain(found: Shortage, problem: AmountProblem, wanted: WantedGoal) -> Iterator[Missing]:
    for resource in found.unreachable:
        yield _explain_resource(resource, problem)
    short = [f"{amount:g} {each.subject}" for each, amount in found.short.items()]
    if short := [*short, *([f"{found.short_s:g} s"] if found.short_s else [])]:
        yield Missing(UnreachableReason.AMOUNT, names=tuple(short))
    elif not found.unreachable:
        yield Missing(UnreachableReason.CONTRADICTION, names=tuple(wanted.accept))


def _explain_resource(resource: Resource, problem: AmountProblem) -> Missing:
    """Why there can be none of it: the first on every path to it that nothing makes, or that need each other."""
    reachable, _ = find_reachable(problem)
    seen, left = {resource}, [resource]
    while left:
        makers = [each for each in problem.activities if left[0] in each.makes]
        lacking = {name for each in makers for name in (*each.needs, *each.uses)} - reachable - seen
        seen |= lacking
        left = [*left[1:], *sorted(lacking)]
    made = {name for each in problem.activities for name in each.makes}
    if resource not in made:
        return Missing(UnreachableReason.PREDICATE, str(resource))
    return Missing(UnreachableReason.PRECONDITION, str(resource), tuple(map(str, sorted(seen - made or seen))))
