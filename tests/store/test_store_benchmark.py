"""The benchmark of the store runs, and what it counts is as promised; its times are for a quiet machine."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "store.py"
COUNTED = ("waits_per_session", "claims_double", "claims_lost", "statechart_models_mb")


@pytest.mark.journey
def test_a_quick_look_at_the_store_counts_what_is_promised(tmp_path):
    ended = subprocess.run(
        [sys.executable, str(BENCHMARK), "--quick"],
        check=False,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )

    told = json.loads(ended.stdout.splitlines()[-1])
    figures, asked = told["figures"], told["asked"]
    assert ended.returncode == (0 if told["holds"] else 1), ended.stderr
    assert {name: figures[name] <= float(asked[name].removeprefix("<= ")) for name in COUNTED} == dict.fromkeys(
        COUNTED, True
    )
    assert figures["claims_smallest_share"] > 0
    assert asked.keys() <= figures.keys()
    assert figures["start_sessions"] == 1000
    assert list(tmp_path.iterdir()) == []
