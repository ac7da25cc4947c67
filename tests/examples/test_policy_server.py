"""Example 3: a policy server that imitates a demonstration. It always says "done"; the verdict may not agree."""

import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "projects" / "03_policy_server"
GRAPH = EXAMPLE / "goal_graphs/imitate.yaml"


@contextmanager
def serve(bundle):
    command = [sys.executable, EXAMPLE / "server.py", bundle]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout.readline().startswith("serving at tcp://127.0.0.1:5555")
            yield server
        finally:
            server.kill()


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    return Workspace.create(tmp_path_factory.mktemp("policy") / "w", Library.open(EXAMPLE))


@pytest.fixture(scope="module")
def mission(workspace):
    with open_bench(workspace, SystemClock(), memory_use=MemoryUse.NONE) as agent:
        yield agent.mission


@pytest.fixture(scope="module")
def demonstration(mission, workspace, tmp_path_factory):
    """Evidence folder of a red cube that was put into its tray, seed 7."""
    graph = tmp_path_factory.mktemp("shown") / "shown.yaml"
    graph.write_text(GRAPH.read_text().replace("skill: imitate", "skill: pick_and_place").replace("imitate", "shown"))
    report = mission.run(graph, seed=7)
    assert report.verdict == "success", report
    return workspace.evidence_of("shown-7.red")


def run_imitation(mission, name, seed):
    report = mission.run(GRAPH, seed=seed, goal=name)
    return report.exit_code, report.sessions[0]


@pytest.mark.journey
def test_where_the_scene_stands_as_it_was_shown_it_meets_the_goal_and_elsewhere_it_only_says_so(mission, demonstration):
    with serve(demonstration):
        code, session = run_imitation(mission, "same", 7)
        assert (code, session.verdict) == (0, "success")
        code, session = run_imitation(mission, "other", 11)
        assert (code, session.verdict) == (1, "failure")
    assert session.ended == "completed", "the policy itself reported that it was done"
