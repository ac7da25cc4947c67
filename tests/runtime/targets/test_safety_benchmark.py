"""The benchmark of the safety layers runs, and what it counts is as promised; its times are for a quiet machine."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.sim

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "safety.py"
NEVER = (
    "rows_outside_position",
    "rows_outside_velocity",
    "rows_outside_torque",
    "rows_outside_workspace",
    "hostile_passed",
    "legitimate_refused",
    "commands_after_asked",
    "stops_still_moving",
)


def test_a_quick_attack_passes_no_limit_and_no_command_follows_a_stop(tmp_path):
    ended = subprocess.run(
        [sys.executable, str(BENCHMARK), "--quick"],
        check=False,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )

    assert ended.returncode in {0, 1}, ended.stderr
    told = json.loads(ended.stdout.splitlines()[-1])
    figures = told["figures"]
    assert {name: figures[name] for name in NEVER} == dict.fromkeys(NEVER, 0)
    assert set(NEVER) < told["asked"].keys() <= figures.keys()
    assert figures["hostile"] == 600
    assert figures["legitimate"] > 900
    assert figures["driven_accepted"] > 50
    assert figures["stops"] == 6
    assert list(tmp_path.iterdir()) == []
