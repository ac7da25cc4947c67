"""Example 3: a policy server that imitates a demonstration. It always says "done"; the verdict may not agree."""

import json
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "03_policy_server"
GRAPH = EXAMPLE / "goal_graphs/imitate.yaml"


def paos(*arguments):
    command = [sys.executable, "-m", "phyagentos", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


@contextmanager
def serve(bundle):
    command = [sys.executable, EXAMPLE / "server.py", bundle]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout.readline().startswith("serving at tcp://127.0.0.1:5555")
            yield server
        finally:
            server.kill()


@pytest.fixture(scope="module")
def demonstration(tmp_path_factory):
    """Evidence folder of a red cube that was put into its tray, seed 7."""
    folder = tmp_path_factory.mktemp("shown")
    graph = folder / "shown.yaml"
    graph.write_text(GRAPH.read_text().replace("skill: imitate", "skill: pick_and_place").replace("imitate", "shown"))
    done = paos("run", graph, "--seed", 7, "--workspace", folder / "w", "--no-pictures", "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "w/evidence/shown-7.red"


def run_imitation(workspace, seed):
    done = paos("run", GRAPH, "--seed", seed, "--workspace", workspace, "--no-pictures", "--json")
    return done.returncode, json.loads(done.stdout)["goal"]["sessions"][0]


def test_it_lints_clean():
    linted = paos("lint", EXAMPLE)
    assert (linted.returncode, linted.stderr) == (0, "")


@pytest.mark.journey
def test_without_its_server_it_is_rejected_before_anything_moves(tmp_path):
    code, session = run_imitation(tmp_path / "w", 7)
    assert (code, session["state"]) == (3, "rejected")


@pytest.mark.journey
def test_where_the_scene_stands_as_it_was_shown_it_meets_the_goal_and_elsewhere_it_only_says_so(
    demonstration, tmp_path
):
    with serve(demonstration):
        code, session = run_imitation(tmp_path / "same", 7)
        assert (code, session["verdict"]) == (0, "success")
        code, session = run_imitation(tmp_path / "other", 11)
        assert (code, session["verdict"]) == (1, "failure")
    execution = json.loads(next((tmp_path / "other/evidence").glob("imitate-11.red/execution.json")).read_text())
    assert execution["ended"] == "completed", "the policy itself reported that it was done"
