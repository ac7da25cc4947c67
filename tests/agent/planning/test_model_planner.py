"""Plans of a model: what is checked of them, what goes back to it, and what it cannot make happen."""

import itertools
import json

import pytest

from phyagentos.agent.planning.answer_sets import solve
from phyagentos.agent.planning.model_planner import ModelPlanner, check_plan, shorten
from phyagentos.agent.planning.problem import Capacity, Condition, Operator, Plan, PlanningProblem
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.network.chat import Completion

pytestmark = pytest.mark.fast


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
    found, _, _ = plan(["open", "open", "knock", "put", "close", "open", "close"])

    assert name_steps(found) == ["open", "put", "close"]


@pytest.mark.parametrize(
    ("steps", "why"),
    [
        (["put", "close"], "step 1, put, needs opened"),
        (["open", "close", "put"], "step 3, put, needs opened"),
        (["open", "put"], "not true at the end: closed"),
        (["open", "put", "close", "knock"], "not true at the end: inside"),
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
