"""`paos plan` with amounts: the files of the how-to page, and what it says where amounts do not suffice."""

import json
import re
from pathlib import Path

import pytest
import yaml

from phyagentos.cli.outcome import ExitCode
from tests.command_line import assert_ended, assert_refused

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "recipes.md"

pytestmark = pytest.mark.sim  # the scene is drawn; nothing is stepped


@pytest.fixture
def project(tmp_path):
    """The files of the page."""
    skill, book, goal = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    folder = tmp_path / "skills" / "craft"
    folder.mkdir(parents=True)
    (folder / "SKILL.md").write_text(f"---\n{skill}---\n")
    (folder / "recipes.yaml").write_text(book)
    (tmp_path / "goal_graphs").mkdir()
    (tmp_path / "goal_graphs" / "floor.yaml").write_text(goal)
    return tmp_path


def test_the_page_plans_its_own_goal(paos, project):
    goal = project / "goal_graphs" / "floor.yaml"
    found = json.loads(paos("plan", goal, "--json").out)
    amounts = {each["parameters"]["item"]: each["parameters"]["count"] for each in found["sessions"]}
    assert amounts == {"log": 5, "planks": 20, "stick": 4, "axe": 1, "plank_floor": 2}
    assert yaml.safe_load(found["graph"])["budget"] == {"sim_time_s": 60.0}
    text = ["craft_plank_floor: craft(item=plank_floor, count=2)", "craft makes 4 planks from 1 log, 5 times, in 5 s"]
    files = project / "pddl" / "domain.pddl", project / "pddl" / "problem.pddl"
    assert_ended(paos("plan", goal, "--pddl", project / "pddl"), ExitCode.GOAL_MET, out=text, err=list(map(str, files)))
    assert files[0].read_text().count("(:action") == 5
    assert "(>= (holds_plank_floor) 2)" in files[1].read_text()


@pytest.mark.parametrize(
    ("old", "new", "lack"),
    [
        ("holds(axe)", "holds(gate)", "precondition: holds(gate): it needs nearby(saw_bench) first"),
        ("holds(axe)", "holds(glass)", "predicate: holds(glass): no skill guarantees it"),
        ("sim_time_s: 60", "sim_time_s: 20", "amount: amounts do not suffice; there would have to be 4 s more"),
    ],
)
def test_what_is_missing_is_proven_and_said(paos, project, old, new, lack):
    goal = project / "goal_graphs" / "floor.yaml"
    goal.write_text(goal.read_text().replace(old, new))
    assert_ended(paos("plan", goal), ExitCode.GOAL_NOT_MET, out=["there is no plan", lack])


def test_a_goal_of_other_statements_has_no_pddl(paos, project):
    goal = project / "goal_graphs" / "floor.yaml"
    goal.write_text(goal.read_text().replace('["holds(plank_floor) >= 2", "holds(axe)"]', '["upright(red_block)"]'))
    assert_refused(paos("plan", goal, "--pddl", project / "pddl"), "NO_CANDIDATE", "items, vitals or stations")
