"""What was verified on one seed helps on another, on the real path, and is gone with the memory."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "evolution.py"

pytestmark = pytest.mark.journey


def test_a_seed_that_was_learned_from_helps_on_another_and_the_gain_goes_with_the_memory(tmp_path):
    done = subprocess.run(
        [sys.executable, str(BENCHMARK), "--quick", "--keep", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )

    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(done.stdout.splitlines()[-1])["figures"]
    assert figures["after"] > figures["before"]
    assert figures["emptied"] == figures["before"]
    assert figures["false_successes"] == 0
