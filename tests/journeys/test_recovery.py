"""Repair and diagnosis on the real path, in the smallest size of their benchmarks."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.journey


def run_benchmark(name: str, *arguments: str) -> tuple[int, dict[str, float], str]:
    command = [sys.executable, str(ROOT / "benchmarks" / name), "--seeds", "1", "--sense", "truth", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout.splitlines()[-1])["figures"], done.stdout + done.stderr


def test_a_hemmed_in_cube_and_a_carton_too_wide_are_had_by_clearing_and_by_pushing(tmp_path):
    cases = ("--cases", "hemmed", "wide", "--policies", "repair", "--keep", str(tmp_path))
    _, figures, told = run_benchmark("recovery.py", *cases)
    assert figures["repair_success"] == 1.0, told
    assert "flowchart TD" in (document := (tmp_path / "repair" / "TASK.md").read_text())
    assert "-- clears -->" in document


def test_a_hand_and_a_slip_are_told_apart():
    code, figures, told = run_benchmark("diagnosis.py", "--cases", "moved", "dropped")
    assert (code, figures["right"], figures["with_support"]) == (0, 1.0, 1.0), told
