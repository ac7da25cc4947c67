"""Example 1: a skill out of existing leaves, YAML alone."""

from pathlib import Path

from tests.command_line import assert_ended

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "projects" / "01_yaml_skill"


def test_it_holds_no_python():
    assert not list(EXAMPLE.rglob("*.py"))


def test_its_tree_is_drawn_with_the_trees_that_ship(paos):
    assert_ended(
        paos("tree", "show", EXAMPLE / "trees/show_and_place.yaml"), 0, out=["plan_grasp", "hold_up · move_home"]
    )
