"""The planner: fewest rounds, stages in order, proofs that there is no plan, and the order that effects allow."""

from dataclasses import replace

import networkx as nx

from phyagentos.agent.planning import answer_sets
from phyagentos.agent.planning.answer_sets import solve as solve_problem
from phyagentos.agent.planning.problem import (
    Capacity,
    Condition,
    Operator,
    Plan,
    PlanningProblem,
    ProvenUnsolvable,
    find_causal_links,
    order_steps,
)


def at(item, place):
    return f"at({item}, {place})"


def move(item, place, places, requires=None):
    changes = {at(item, each): each == place for each in places}
    return Operator(
        name=f"{item}>{place}", skill="move", target="r", parameters={}, requires=requires or {}, changes=changes
    )


def want(*facts, least=None):
    conditions = tuple(Condition(((fact, True),), 1, 1, fact) for fact in facts)
    return conditions if least is None else (Condition(tuple((f, True) for f in facts), least, len(facts)),)


def make_problem(objects, places, start, *stages, room=None, capacities=True):
    room = room or dict.fromkeys(places, 1)
    return PlanningProblem(
        operators=tuple(move(item, place, places) for item in objects for place in places),
        initial=frozenset(at(item, place) for item, place in start.items()),
        stages=stages,
        capacities=tuple(Capacity(p, {at(t, p): 1 for t in objects}, n) for p, n in room.items()) if capacities else (),
        exclusive=tuple(frozenset(at(item, place) for place in places) for item in objects),
        exact=tuple(frozenset(at(item, place) for place in places) for item in objects),
    )


def solve(problem):
    return solve_problem(problem)


def names(plan):
    assert isinstance(plan, Plan), plan
    return [operator.name for operator in plan.operators]


def test_two_objects_in_two_full_places_change_over_a_free_one():
    problem = make_problem(("a", "b"), ("x", "y", "spot"), {"a": "x", "b": "y"}, want(at("a", "y"), at("b", "x")))
    plan = solve(problem)
    assert len(names(plan)) == 3
    assert "spot" in names(plan)[0]
    assert nx.is_path(order_steps(problem, plan), range(3))


def test_without_a_free_place_it_is_proven_that_they_cannot():
    problem = make_problem(("a", "b"), ("x", "y"), {"a": "x", "b": "y"}, want(at("a", "y"), at("b", "x")))
    assert solve(problem) == ProvenUnsolvable()


def test_more_than_a_place_holds_is_proven_impossible():
    start = {"a": "table", "b": "table", "c": "table"}
    goal = want(*(at(item, "x") for item in start))
    problem = make_problem(tuple(start), ("x", "table"), start, goal, room={"x": 2, "table": 3})
    assert solve(problem) == ProvenUnsolvable()


def test_a_fact_that_no_operator_makes_true_is_named():
    problem = make_problem(("a",), ("x", "y"), {"a": "x"}, want("painted(a)"))
    assert solve(problem) == ProvenUnsolvable(("painted(a)",))


def test_stages_are_reached_one_after_the_other():
    start, room = {"a": "x", "b": "x"}, {"x": 2, "y": 2}
    stages = (want(at("b", "y")), want(at("a", "y")), want(at("b", "x")), want(at("b", "x")))
    problem = make_problem(("a", "b"), ("x", "y"), start, *stages, room=room)
    plan = solve(problem)
    assert names(plan) == ["b>y", "a>y", "b>x"]
    assert plan.reached == (1, 2, 3, 3)
    assert set(order_steps(problem, plan).edges) == {(0, 1), (1, 2)}


def test_what_does_not_depend_on_each_other_has_no_order():
    start = {"a": "x", "b": "y", "c": "z"}
    places = ("x", "y", "z", "p", "q", "r")
    problem = make_problem(tuple(start), places, start, want(at("a", "p"), at("b", "q"), at("c", "r")))
    plan = solve(problem)
    assert len(names(plan)) == 3
    assert not order_steps(problem, plan).edges
    assert {(link.fact, link.needed_by) for link in find_causal_links(problem, plan)} == {
        (at("a", "p"), None),
        (at("b", "q"), None),
        (at("c", "r"), None),
    }


def test_of_a_number_of_objects_no_more_are_moved_than_are_asked_for():
    start = dict.fromkeys("abcd", "x")
    goal = want(*(at(item, "y") for item in start), least=2)
    problem = make_problem(tuple(start), ("x", "y"), start, goal, room={"x": 4, "y": 4})
    assert len(names(solve(problem))) == 2


def test_a_dearer_operator_is_left_where_a_cheaper_one_does():
    cheap, dear = move("a", "y", ("x", "y")), move("a", "y", ("x", "y"))
    dear = Operator(**{key: getattr(dear, key) for key in dear.__slots__} | {"name": "dear", "cost": 5})
    problem = PlanningProblem(operators=(dear, cheap), initial=frozenset({at("a", "x")}), stages=(want(at("a", "y")),))
    assert names(solve(problem)) == ["a>y"]


def test_an_answer_within_no_limit_says_that_it_is_none(monkeypatch):
    monkeypatch.setattr(answer_sets, "ROUNDS_MAX", 1)
    monkeypatch.setattr(answer_sets, "ROUNDS_PROOF", -1)
    problem = make_problem(("a", "b"), ("x", "y", "spot"), {"a": "x", "b": "y"}, want(at("a", "y"), at("b", "x")))
    assert solve(problem) is None


def test_what_the_solver_reads_does_not_depend_on_the_order_of_a_set(monkeypatch):
    class Reversed(frozenset):
        def __iter__(self):
            return iter(reversed([*super().__iter__()]))

    programs, describe = [], answer_sets._describe
    monkeypatch.setattr(answer_sets, "_describe", lambda *given: programs.append(describe(*given)) or programs[-1])
    problem = make_problem(("a", "b"), ("x", "y"), {"a": "x", "b": "y"}, want(at("a", "y"), at("b", "y")))
    for initial in (problem.initial, Reversed(problem.initial)):
        solve(replace(problem, initial=initial))
    assert programs[0] == programs[1]
