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


@pytest.mark.journey
def test_both_cubes_are_put_away_at_once_and_a_second_run_has_the_same_bits(tmp_path):
    arrays = []
    for name in ("a", "b"):
        graph = EXAMPLE / "goal_graphs/two_arms.yaml"
        done = paos("run", graph, "--seed", 7, "--workspace", tmp_path / name, "--no-pictures")
        assert done.returncode == 0, done.stdout + done.stderr
        files = sorted((tmp_path / name / "evidence").glob("*/*.npz"))
        assert {file.name for file in files} >= {"trajectory.npz", "terminal.npz", "initial.npz"}
        arrays.append({f"{file.parent.name}/{file.name}": file.read_bytes() for file in files})
        starts = {key: value for key, value in arrays[-1].items() if key.endswith("initial.npz")}
        assert len(set(starts.values())) == 1 < len(starts)  # both sessions began in one state of one world

    assert arrays[0] == arrays[1]
    refused = paos("rerun", "two_arms-7.red", "--workspace", tmp_path / "a")
    assert refused.returncode != 0
    assert "WORLD_CONFLICT" in refused.stderr
