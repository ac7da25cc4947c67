"""Example 4: two arms at one table, each with its cube, in one simulated time."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "04_two_arms"


def paos(*arguments):
    command = [sys.executable, "-m", "phyagentos", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


def test_it_lints_clean():
    linted = paos("lint", EXAMPLE)

    assert (linted.returncode, linted.stderr) == (0, "")


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
    assert "WORLD_SHARED" in refused.stderr
