"""Plans of a model: what is checked of them, what goes back to it, and what it cannot make happen."""

import itertools
import json
import random

import pytest

from phyagentos.agent.planning.answer_sets import solve
from phyagentos.agent.planning.model_planner import ModelPlanner, check_plan, shorten
from phyagentos.agent.planning.problem import Capacity, Condition, Operator, Plan, PlanningProblem, keep_relevant
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.network.chat import Completion


def make_operator(name, requires=(), changes=()):
    return Operator(name=name, skill=name, target="arm", parameters={}, requires=dict(requires), changes=dict(changes))


def wants(*facts):
    return tuple(Condition(((fact, True),), 1, 1, fact) for fact in facts)


OPEN = make_operator("open", changes={"opened": True})
PUT = make_operator("put", requires={"opened": True}, changes={"inside": True})
CLOSE = make_operator("close", requires={"opened": True}, changes={"opened": False, "closed": True})
KNOCK = make_operator("knock", changes={"inside": False})
PROBLEM = PlanningProblem(
    operators=(OPEN, PUT, CLOSE, KNOCK), initial=frozenset(), stages=(wants("inside"), wants("closed", "inside"))
)


def plan(*answers, problem=PROBLEM, **limits):
    """What becomes of these answers of a model, and what it was shown for each."""
    given, shown = iter(answers), []

    def complete(messages, **_):
        shown.append([each["content"] for each in messages])
        if (answer := next(given, None)) is None:
            raise ExecutionError("MODEL_FAILED", "no further answer")
        return Completion(answer if isinstance(answer, str) else json.dumps({"steps": answer}))

    planner = ModelPlanner(name="m", complete=complete, clock=SystemClock(), **limits)
    return planner.solve(problem), planner, shown


def name_steps(plan):
    return [each.name for each in plan.operators]


def test_a_plan_that_reaches_each_stage_counts():
    found, planner, _ = plan(["open", "put", "close"])

    assert (name_steps(found), found.reached) == (["open", "put", "close"], (2, 3))
    assert planner.refused == []


def test_steps_that_nothing_needs_are_left_out():
    found, _, _ = plan(["open", "open", "knock", "put", "close", "knock", "put"])

    assert name_steps(found) == ["open", "put", "close"]


@pytest.mark.parametrize(
    ("steps", "why"),
    [
        (["put", "close"], "step 1, put, needs opened"),
        (["open", "close", "put"], "step 3, put, needs opened"),
        (["open", "put"], "not true at the end: closed"),
        (["open", "put", "knock", "close"], "not true at the end: inside"),
        (["open", "close"], "never true: inside"),
        (["fly"], "no such action: fly"),
        ([], "steps: "),
        ("I would open it first", "answer: "),
    ],
)
def test_what_is_wrong_with_a_plan_goes_back_and_a_corrected_one_counts(steps, why):
    found, _, shown = plan(steps, ["open", "put", "close"])

    assert name_steps(found) == ["open", "put", "close"]
    assert why in shown[1][-1]


def test_without_a_plan_within_its_rounds_there_is_none_and_the_last_problems_are_kept():
    found, planner, shown = plan(*[["put"]] * 9, rounds=4)

    assert found is None
    assert len(shown) == 4
    assert planner.refused == ["step 1, put, needs opened"]


def test_a_model_that_fails_plans_nothing():
    found, planner, _ = plan()

    assert (found, planner.refused) == (None, ["MODEL_FAILED: no further answer"])


def test_no_place_is_overfull_on_the_way():
    one, other = (make_operator(name, changes={name: True}) for name in ("one", "other"))
    out = make_operator("out", requires={"one": True}, changes={"one": False, "clean": True})
    problem = PlanningProblem(
        operators=(one, other, out),
        initial=frozenset(),
        stages=(wants("other", "clean"),),
        capacities=(Capacity("tray", {"one": 1, "other": 1}, 1),),
    )
    found, _, shown = plan(["one", "other", "out"], ["one", "out", "other"], problem=problem)

    assert name_steps(found) == ["one", "out", "other"]
    assert "after step 2: no room in tray" in shown[1][-1]


def test_a_goal_that_is_met_needs_no_model():
    found, _, shown = plan(problem=PlanningProblem(operators=(OPEN,), initial=frozenset({"a"}), stages=(wants("a"),)))

    assert (found, shown) == (Plan((), (0,)), [])


def test_the_check_agrees_with_the_engine_that_ships():
    found = solve(PROBLEM)
    assert check_plan(PROBLEM, found.operators) == found
    plans = [each for n in range(4) for each in itertools.product(PROBLEM.operators, repeat=n)]
    right = [each for each in plans if isinstance(check_plan(PROBLEM, each), Plan)]
    assert right == [found.operators]
    assert shorten(PROBLEM, found) == found


def test_it_is_shown_only_what_can_matter():
    far = make_operator("far", requires={"lit": True}, changes={"elsewhere": True})
    lit = PlanningProblem(
        operators=(
            OPEN,
            make_operator("put", {"opened": True, "lit": True}, {"inside": True, "elsewhere": False}),
            far,
        ),
        initial=frozenset({"lit"}),
        stages=(wants("inside"),),
    )
    _, planner, _ = plan(["open", "put"], problem=lit)

    (text,) = planner.shown.values()
    assert "put:\n  requires: opened\n  makes: inside\n" in text
    assert "far" not in text
    assert "lit" not in text


def draw_problem(chance):
    facts = "abcdef"

    def draw_literals(most):
        return {fact: chance.random() < 0.6 for fact in chance.sample(facts, chance.randint(1, most))}

    operators = [make_operator(f"step{n}", draw_literals(2), draw_literals(3)) for n in range(6)]
    stages = [
        tuple(
            Condition(tuple(found.items()), chance.randint(1, len(found)), len(found) - chance.randint(0, 1))
            for found in [draw_literals(2)]
        )
        for _ in range(chance.randint(1, 2))
    ]
    initial = frozenset(chance.sample(facts, 2))
    capacities = (Capacity("tray", {"a": 1, "b": 1, "c": 1}, max(1, len(initial & set("abc")))),)
    return PlanningProblem(operators=tuple(operators), initial=initial, stages=tuple(stages), capacities=capacities)


@pytest.mark.slow
def test_what_can_matter_is_enough_for_the_shortest_plan():
    problems = [draw_problem(random.Random(seed)) for seed in range(80)]
    plans = [(problem, solve(problem), solve(keep_relevant(problem))) for problem in problems]
    solved = [each for each in plans if isinstance(each[1], Plan)]

    assert len(solved) > 12
    for problem, whole, kept in solved:
        assert len(kept.reached) == len(whole.reached)
        names = {each.name: each for each in problem.operators}
        assert isinstance(check_plan(problem, [names[each.name] for each in kept.operators]), Plan)
        assert sum(each.cost for each in kept.operators) <= sum(each.cost for each in whole.operators)
