"""A goal's ways, to a motor and back to a verdict, are as short as is claimed."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.journey
TOOL = Path(__file__).parents[2] / "tools" / "count_hops.py"


def test_no_way_through_the_code_is_longer_than_forty_calls_and_messages():
    counted = subprocess.run([sys.executable, TOOL, "--quiet"], capture_output=True, text=True, check=False)
    assert counted.returncode == 0, counted.stdout + counted.stderr
