"""The benchmark of orchestration runs, and every session of it succeeds on evidence that is on the disk."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "orchestration.py"

pytestmark = pytest.mark.journey


def test_a_hundred_sessions_without_work_run_in_layers_and_in_a_chain():
    done = subprocess.run(
        [sys.executable, str(BENCHMARK), "--quick"], capture_output=True, text=True, timeout=300, check=False
    )

    assert done.returncode == 0, done.stdout + done.stderr
    outcome = json.loads(done.stdout.splitlines()[-1])
    assert outcome["holds"] is True
    assert outcome["figures"]["sessions"] == 100
    assert min(outcome["figures"]["layered_per_s"], outcome["figures"]["chain_per_s"]) > 0
