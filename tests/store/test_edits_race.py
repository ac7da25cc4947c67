"""Three kinds of editors against a publisher in another process: the benchmark with small counts."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "edits.py"


@pytest.fixture
def run_benchmark(tmp_path):
    def run(edits, rounds, kind, kills=0):
        counts = ["--edits", str(edits), "--rounds", str(rounds), "--kills", str(kills)]
        command = [sys.executable, str(BENCHMARK), *counts, "--only", kind]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
        assert done.returncode in {0, 1}, done.stderr
        return json.loads(done.stdout.splitlines()[-1])["figures"]

    return run


@pytest.mark.timeout(0)  # nightly takes an hour
def test_no_edit_of_three_editors_is_lost_while_the_file_is_rendered(run_benchmark, pytestconfig):
    edits, rounds = (150, 45) if pytestconfig.getoption("--nightly") else (30, 1)
    figures = run_benchmark(edits, rounds, "exchange + merge")

    assert (figures["edits"], figures["exchange_lost"]) == (3 * edits * rounds, 0)
    assert figures["exchange_renderings_per_s"] > 1


@pytest.mark.timeout(0)
def test_no_edit_is_lost_when_the_renderer_is_killed(run_benchmark, pytestconfig):
    edits, rounds, kills = (150, 10, 20) if pytestconfig.getoption("--nightly") else (12, 1, 2)
    figures = run_benchmark(edits, rounds, "exchange + merge", kills)

    assert (figures["edits"], figures["exchange_lost"]) == (3 * edits * rounds, 0)


def test_the_count_of_lost_edits_can_fail(run_benchmark):
    figures = run_benchmark(3, 1, "plain rename")

    assert figures["plain_lost"] == 9
