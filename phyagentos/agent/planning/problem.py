"""The port of planners: facts that operators make true or false, what an engine answers, and the order of a plan.

Upstream: the domain of a goal. Downstream: an engine. A fact is the canonical text of a predicate; what is not stated
true is false. Alternative: PDDL with unified-planning, whose complete engines are GPL or weigh over 200 MB.

A step comes before another one where it brings about what that needs, where it would undo that, where both write one
fact differently, or where they share a place that could be overfull; the rest may be done in any order
(Bäckström 1998).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import networkx as nx

Fact = str
Literal = tuple[Fact, bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Operator:
    """One skill with its arguments: which facts must be true or false before, and which are afterwards; others stay.

    Plans with the least sum of costs are preferred; each is at least 1.
    """

    name: str
    skill: str
    target: str
    parameters: Mapping[str, Any]
    requires: Mapping[Fact, bool]
    changes: Mapping[Fact, bool]
    cost: int = 1
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Condition:
    """So many of some literals, each a fact and the value that counts; one of one is a plain condition."""

    literals: tuple[Literal, ...]
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
    """Operators in an order that reaches the goal; `reached` counts for each stage those that come before it."""

    operators: tuple[Operator, ...]
    reached: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class ProvenUnsolvable:
    """No sequence of operators reaches the goal.

    Attributes:
        unreachable: Facts of the goal that no sequence brings about even if nothing were ever undone; empty where only
            their combination is impossible.
    """

    unreachable: tuple[Fact, ...] = ()


@dataclass(frozen=True, slots=True)
class CausalLink:
    """A step makes a fact true or false for a later one; `needed_by` is None for the goal."""

    made_by: int
    fact: Fact
    value: bool
    needed_by: int | None


def keep_relevant(problem: PlanningProblem) -> PlanningProblem:
    """The operators that a plan without needless steps can have, and of what they require and change what can matter.

    A literal that is true from the start, and that none of these operators undoes, needs nothing to bring it about.
    """
    goal = {
        (fact, kept)
        for stage in problem.stages
        for each in stage
        for fact, value in each.literals
        for kept in ((value,) if each.most >= len(each.literals) else (True, False))
    }
    operators: tuple[Operator, ...] = ()
    found: tuple[Operator, ...] | None = None
    while found != operators:
        operators = found or ()
        made = {change for each in operators for change in each.changes.items()}
        full = problem.initial | {fact for fact, value in made if value}
        tight = (each for each in problem.capacities if sum(each.weights.get(fact, 0) for fact in full) > each.most)
        wanted = goal | {(fact, False) for each in tight for fact in each.weights}
        wanted |= {literal for each in operators for literal in each.requires.items()}
        useful = {(f, value) for f, value in wanted if (f in problem.initial) is not value or (f, not value) in made}
        found = tuple(each for each in problem.operators if not useful.isdisjoint(each.changes.items()))
    facts = {fact for fact, _ in useful | goal}
    return replace(
        problem,
        initial=problem.initial & facts,
        exact=(),
        operators=tuple(
            replace(
                each,
                requires={fact: value for fact, value in each.requires.items() if fact in facts},
                changes={fact: value for fact, value in each.changes.items() if fact in facts},
            )
            for each in operators
        ),
    )


def iter_states(problem: PlanningProblem, plan: Plan) -> Iterator[Mapping[Fact, bool]]:
    """What is true or false before each step, and in the end; what has no value is false."""
    state = dict.fromkeys(problem.initial, True)
    yield state
    for operator in plan.operators:
        yield (state := {**state, **operator.changes})


def _list_effects(problem: PlanningProblem, plan: Plan) -> list[dict[Fact, bool]]:
    """Of each step the changes that really change something where it stands."""
    return [
        {fact: value for fact, value in operator.changes.items() if state.get(fact, False) is not value}
        for operator, state in zip(plan.operators, iter_states(problem, plan), strict=False)
    ]


def find_causal_links(problem: PlanningProblem, plan: Plan) -> tuple[CausalLink, ...]:
    """What each step is there for."""
    made: dict[Fact, int] = {}
    wanted: dict[Literal, None] = {}
    links: list[CausalLink] = []
    effects = _list_effects(problem, plan)
    for index, state in enumerate(iter_states(problem, plan)):
        for stage, reached in zip(problem.stages, plan.reached, strict=True):
            if reached == index:
                wanted |= dict.fromkeys(literal for each in stage for literal in each.literals)
                met = [
                    literal for literal in wanted if literal[0] in made and state.get(literal[0], False) is literal[1]
                ]
                links += [CausalLink(made[fact], fact, value, None) for fact, value in met]
        if index < len(effects):
            needs = plan.operators[index].requires.items()
            links += [CausalLink(made[fact], fact, value, index) for fact, value in needs if fact in made]
            made |= dict.fromkeys(effects[index], index)
    return tuple(dict.fromkeys(links))


def order_steps(problem: PlanningProblem, plan: Plan) -> "nx.DiGraph[int]":
    """The steps of a plan by their index; every order that the graph allows reaches the goal, stage by stage."""
    dag: nx.DiGraph[int] = nx.DiGraph()
    count = len(plan.operators)
    dag.add_nodes_from(range(count))
    links = find_causal_links(problem, plan)
    dag.add_edges_from((link.made_by, link.needed_by) for link in links if link.needed_by is not None)
    pairs = combinations(enumerate(plan.operators), 2)
    dag.add_edges_from((i, j) for (i, one), (j, other) in pairs if _conflict(one, other))
    effects = _list_effects(problem, plan)
    for capacity in problem.capacities:
        entering = {fact for each in plan.operators for fact, value in each.changes.items() if value}
        filled = (entering | problem.initial) & capacity.weights.keys()
        if sum(capacity.weights[fact] for fact in filled) > capacity.most:
            dag.add_edges_from(pairwise(i for i in range(count) if effects[i].keys() & capacity.weights.keys()))
    for border in plan.reached:
        dag.add_edges_from((i, j) for i in range(border) for j in range(border, count))
    return nx.transitive_reduction(dag)


def _conflict(one: Operator, other: Operator) -> bool:
    """Whether the later one undoes what the earlier one needs, or writes a fact differently."""
    literals = (*one.requires.items(), *one.changes.items())
    return any(other.changes.get(fact, value) is not value for fact, value in literals)
