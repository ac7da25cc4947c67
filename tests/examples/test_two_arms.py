"""Example 4: two arms at one table, each with its cube, in one simulated time."""

import shutil
from pathlib import Path

import pytest

from tests.command_line import assert_refused

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "projects" / "04_two_arms"


@pytest.fixture
def of_two_drivers(tmp_path):
    """The example, whose right arm another driver moves."""
    project = tmp_path / "project"
    shutil.copytree(EXAMPLE, project)
    profile = project / "robots" / "right_arm" / "target.yaml"
    text = profile.read_text()
    assert "model: ../panda/panda.xml" in text
    shutil.copytree(ROOT / "robots" / "panda", project / "robots" / "panda")
    profile.write_text(text.replace("world: table\n", "world: table\ndriver: remote\nendpoint: ws://127.0.0.1:1\n"))
    return project


FOUND = "WORLD_CONFLICT: found driver 'remote' of 'right_arm' in the shared world 'table'"


@pytest.mark.slow
def test_a_driver_that_cannot_share_is_found_by_lint_in_profile_and_goal(of_two_drivers, paos):
    in_profile, in_goal = f"right_arm/target.yaml: world: {FOUND}", f"two_arms.yaml:6:1: {FOUND}"
    assert_refused(paos("lint", of_two_drivers), in_profile, in_goal, "4 problems")  # the profile, each of three goals


@pytest.mark.journey
def test_without_a_goal_that_names_the_world_the_start_is_refused_and_nothing_moves(of_two_drivers, tmp_path, paos):
    graph = of_two_drivers / "goal_graphs" / "two_arms.yaml"
    graph.write_text(graph.read_text().replace("worlds: {table: [left, right]}\n", ""))

    done = paos("run", graph, "--workspace", tmp_path / "w", "--no-pictures")

    assert done.code == 3, done.err
    assert "WORLD_CONFLICT" in done.out + done.err
    assert not [*(tmp_path / "w" / "logs").glob("world-*.log"), *(tmp_path / "w" / "logs").glob("receive-*.jsonl")]
