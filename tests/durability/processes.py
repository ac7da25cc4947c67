"""Rounds that fork their writers, run in a process of their own, which answers with one JSON line."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def run_module(name: str, *options: object) -> dict[str, Any]:
    """The `counts` and `errors` of `tests.durability.<name>`."""
    command = [sys.executable, "-m", f"tests.durability.{name}", *map(str, options)]
    done = subprocess.run(command, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, check=False)
    assert done.stdout, done.stderr
    return json.loads(done.stdout)
