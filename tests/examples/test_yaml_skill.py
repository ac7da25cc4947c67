"""Example 1: a skill out of existing leaves, YAML alone."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "projects" / "01_yaml_skill"


def start(*arguments, cwd=ROOT):
    command = [sys.executable, "-m", "phyagentos", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=300)


def test_it_holds_no_python():
    assert not list(EXAMPLE.rglob("*.py"))


@pytest.mark.slow
def test_it_lints_clean():
    linted = start("lint", EXAMPLE)
    assert (linted.returncode, linted.stderr) == (0, "")


@pytest.mark.slow
def test_its_tree_is_drawn_with_the_trees_that_ship():
    drawn = start("tree", "show", EXAMPLE / "trees/show_and_place.yaml")
    assert drawn.returncode == 0, drawn.stderr
    assert "plan_grasp" in drawn.stdout
    assert "hold_up · move_home" in drawn.stdout


@pytest.mark.journey
def test_it_runs_to_a_met_goal_and_json_is_all_that_stdout_holds(tmp_path, paos):
    graph = EXAMPLE / "goal_graphs/show.yaml"
    done = start("run", graph, "--workspace", tmp_path / "w", "--no-pictures", "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert report["goal"]["verdict"] == "success"
    assert [session["skill"] for session in report["goal"]["sessions"]] == ["show_and_place"]
    assert "red: running" in done.stderr
    checked = paos("evidence", "verify", "-w", tmp_path / "w")
    assert (checked.code, checked.out) == (0, "1 bundle checked: as recorded\n"), checked.err
