"""The partial order that the effects of a plan allow.

A step comes before another one where it brings about what that needs, where it would undo that, where both write one
fact differently, or where they share a place that could be overfull; the rest may be done in any order
(Bäckström 1998).
"""

from dataclasses import dataclass
from itertools import combinations, pairwise

import networkx as nx

from phyagentos.agent.planning.problem import Fact, Operator, Plan, PlanningProblem


@dataclass(frozen=True, slots=True)
class CausalLink:
    """A step makes a fact true or false for a later one; `needed_by` is None for the goal."""

    made_by: int
    fact: Fact
    value: bool
    needed_by: int | None


def find_causal_links(problem: PlanningProblem, plan: Plan) -> tuple[CausalLink, ...]:
    """What each step is there for."""
    state = dict.fromkeys(problem.initial, True)
    made: dict[Fact, int] = {}
    links: list[CausalLink] = []
    wanted: dict[tuple[Fact, bool], None] = {}
    for index in range(len(plan.operators) + 1):
        for stage, reached in zip(problem.stages, plan.reached, strict=True):
            if reached == index:
                wanted |= {literal: None for each in stage for literal in each.literals}
                links += [
                    CausalLink(made[fact], fact, value, None)
                    for fact, value in wanted
                    if fact in made and state.get(fact, False) is value
                ]
        if index == len(plan.operators):
            break
        operator = plan.operators[index]
        links += [CausalLink(made[f], f, value, index) for f, value in operator.requires.items() if f in made]
        made |= {fact: index for fact, value in operator.changes.items() if state.get(fact, False) is not value}
        state |= operator.changes
    return tuple(dict.fromkeys(links))


def order_steps(problem: PlanningProblem, plan: Plan) -> "nx.DiGraph[int]":
    """The steps of a plan by their index; every order that the graph allows reaches the goal.

    The stages of a goal stay apart: all that comes before one is reached is done before all that comes after.
    """
    dag: nx.DiGraph[int] = nx.DiGraph()
    dag.add_nodes_from(range(len(plan.operators)))
    for link in find_causal_links(problem, plan):
        if link.needed_by is not None:
            dag.add_edge(link.made_by, link.needed_by)
    for (i, one), (j, other) in combinations(enumerate(plan.operators), 2):
        if _conflict(one, other):
            dag.add_edge(i, j)
    for capacity in problem.capacities:
        entering = [{f for f in each.changes if f in capacity.weights and each.changes[f]} for each in plan.operators]
        filled = set().union(*entering) | (problem.initial & capacity.weights.keys())
        if sum(capacity.weights[fact] for fact in filled) > capacity.most:
            users = [i for i, each in enumerate(plan.operators) if capacity.weights.keys() & each.changes.keys()]
            changing = [i for i in users if _changes(problem, plan, i, capacity.weights.keys())]
            dag.add_edges_from(pairwise(changing))
    for border in {reached for reached in plan.reached if 0 < reached < len(plan.operators)}:
        dag.add_edges_from((i, j) for i in range(border) for j in range(border, len(plan.operators)))
    return nx.transitive_reduction(dag)


def _conflict(one: Operator, other: Operator) -> bool:
    """Whether the later one undoes what the earlier one needs, or writes a fact differently."""
    undone = any(other.changes.get(fact, value) is not value for fact, value in one.requires.items())
    return undone or any(other.changes.get(fact, value) is not value for fact, value in one.changes.items())


def _changes(problem: PlanningProblem, plan: Plan, index: int, facts: "set[Fact] | object") -> bool:
    """Whether a step really changes one of some facts where it stands in the plan."""
    state = dict.fromkeys(problem.initial, True)
    for operator in plan.operators[:index]:
        state |= operator.changes
    changes = plan.operators[index].changes.items()
    return any(fact in facts and state.get(fact, False) is not value for fact, value in changes)  # type: ignore[operator]
