"""Example 4: two arms at one table, each with its cube, in one simulated time."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "projects" / "04_two_arms"


def paos(*arguments):
    command = [sys.executable, "-m", "phyagentos", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.slow
def test_it_lints_clean():
    linted = paos("lint", EXAMPLE)

    assert (linted.returncode, linted.stderr) == (0, "")


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
def test_a_driver_that_cannot_share_is_found_by_lint_in_profile_and_goal(of_two_drivers):
    linted = paos("lint", of_two_drivers)

    assert linted.returncode == 2
    assert f"right_arm/target.yaml: world: {FOUND}" in linted.stderr
    assert f"two_arms.yaml:6:1: {FOUND}" in linted.stderr
    assert "4 problems" in linted.stderr  # the profile, and each of the three goals


@pytest.mark.journey
def test_without_a_goal_that_names_the_world_preflight_and_the_start_refuse_and_nothing_moves(of_two_drivers, tmp_path):
    graph = of_two_drivers / "goal_graphs" / "two_arms.yaml"
    graph.write_text(graph.read_text().replace("worlds: {table: [left, right]}\n", ""))

    checked = paos("preflight", graph)
    done = paos("run", graph, "--workspace", tmp_path / "w", "--no-pictures")

    assert (checked.returncode, done.returncode) == (3, 3), checked.stderr + done.stderr
    assert checked.stdout.count("WORLD_CONFLICT") == 2  # of either arm
    assert "WORLD_CONFLICT" in done.stdout + done.stderr
    assert not [*(tmp_path / "w" / "logs").glob("world-*.log"), *(tmp_path / "w" / "logs").glob("receive-*.jsonl")]
