"""Plans by amounts, as unified-planning validates them, and plans of ENHSP for the same PDDL, as our game plays them.

Both are in the environment of `--planners-python`.
"""

import json
import subprocess
from pathlib import Path

import pytest

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.amounts import iter_amounts
from phyagentos.agent.planning.integer_program import solve
from phyagentos.agent.planning.pddl import FULL, name_action, write_pddl
from phyagentos.agent.planning.recipe_domain import build_recipe_domain
from tests.agent.planning.test_amounts import CATALOGUE, NOTHING, Game, look

SCRIPT = Path(__file__).with_name("with_planners.py")

pytestmark = pytest.mark.extras


def build(accept, now=NOTHING, **more):
    fields = {"goal": "g", "objective": "o", "scene": "s", "targets": {"player": "panda"}}
    return build_recipe_domain(WantedGoal(**fields, accept=accept, **more), CATALOGUE, now).problem


def list_actions(problem, plan):
    """The actions of a plan, by the names that they have in its domain."""
    names = []
    notes = [[f"reach_{k}" for k, at in enumerate(plan.reached[:-1]) if at == i] for i in range(len(plan.batches) + 1)]
    for batch, state, before in zip(plan.batches, iter_amounts(problem, plan.batches), notes, strict=False):
        names += before
        activity = batch.activity
        name = name_action(activity, problem.activities.index(activity))
        rises = {each: activity.makes[each] for each in activity.makes.keys() & problem.most.keys()}
        for time in range(batch.times):
            is_full = any(state.get(r, 0.0) + (time + 1) * rise > problem.most[r] for r, rise in rises.items())
            names.append(f"{name}{FULL}" if is_full else name)
    return names + notes[-1]


@pytest.fixture
def judge(pytestconfig, tmp_path):
    def run(problem, actions, *options):
        files = tmp_path / "domain.pddl", tmp_path / "problem.pddl"
        for file, text in zip(files, write_pddl(problem, "g"), strict=True):
            file.write_text(text)
        command = [pytestconfig.option.planners_python, SCRIPT, *files, *options]
        done = subprocess.run(
            command, check=False, input=json.dumps(actions), capture_output=True, text=True, timeout=240
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return run


@pytest.mark.parametrize(
    ("accept", "more"),
    [
        (("holds(clock)",), {}),
        (("not holds(stick)",), {"steps": [("holds(stick) >= 8",), ("holds(table)",)], "now": look({"log": 3})}),
        (("holds(beef) >= 12",), {"now": look(vitals={"food": 5.0}), "constraints": ("vital(food) >= 3",)}),
    ],
)
def test_what_we_plan_is_valid_for_others(judge, accept, more):
    problem = build(accept, **more)
    plan = solve(problem)
    actions = list_actions(problem, plan)
    assert len(actions) == sum(batch.times for batch in plan.batches) + len(problem.stages) - 1
    assert judge(problem, actions)["valid"]
    assert not judge(problem, actions[1:])["valid"]


@pytest.mark.parametrize("accept", [("holds(clock)",), ("holds(stone_pickaxe)",)])
def test_what_others_plan_is_played_by_our_game(judge, accept):
    problem, game = build(accept), Game()
    for name in judge(problem, list_actions(problem, solve(problem)), "solve")["plan"]:
        game.play(problem, name)
    assert all(game.meets(text) for text in accept)
