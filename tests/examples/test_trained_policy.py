"""Example 10: a trained policy answers with places, and its server follows them within the limits of the arm."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "projects" / "10_train_policy"


@pytest.fixture(scope="module")
def server():
    spec = importlib.util.spec_from_file_location("trained_policy_server", EXAMPLE / "server.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_rows_that_jump_are_followed_within_the_limits_across_chunks(server):
    rng = np.random.default_rng(7)
    tracker, at, sent = server.Tracker(), np.zeros(7), [np.zeros(7)]
    for chunk in range(6):
        rows = tracker.follow(rng.uniform(-0.6, 0.6, 7) + 0.02 * rng.standard_normal((25, 7)), 24 * chunk, at)
        sent += list(rows[:24])
        at = rows[23]
    velocity = np.diff(sent, axis=0) / server.PERIOD_S
    acceleration = np.diff(velocity, axis=0) / server.PERIOD_S
    assert (np.abs(velocity) <= server.VELOCITY_RAD_S + 1e-9).all()
    assert (np.abs(acceleration) <= server.ACCELERATION_RAD_S2 + 1e-6).all()


def test_rows_that_stand_still_are_reached(server):
    tracker, goal = server.Tracker(), np.linspace(-0.3, 0.3, 7)
    for chunk in range(3):
        rows = tracker.follow(np.tile(goal, (25, 1)), 50 * chunk, np.zeros(7))
    assert np.abs(rows[-1] - goal).max() < 1e-3


@pytest.mark.journey
def test_the_trained_policy_puts_the_cube_into_the_tray_and_the_verdict_says_so(tmp_path):
    pytest.importorskip("onnxruntime", reason="needs the extra `onnx`: `make test-extras`")
    command = [sys.executable, EXAMPLE / "server.py", EXAMPLE / "weights" / "state.onnx"]
    workspace = Workspace.create(tmp_path / "w", Library.open(EXAMPLE))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as serving:
        try:
            assert serving.stdout.readline().startswith("serving at tcp://127.0.0.1:5558")
            with open_bench(workspace, SystemClock(), memory_use=MemoryUse.NONE) as agent:
                report = agent.mission.run(EXAMPLE / "goal_graphs" / "cube.yaml", seed=3)
        finally:
            serving.kill()
    assert report.verdict == "success", report
    assert [each.skill for each in report.sessions] == ["pick_by_state"]
