"""An agent directs a session on the real path: it finds a hidden cube; one that only claims so ends failed."""

import pytest

from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.scorers.simulator_state import is_in_tray
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.settings.perception import Sensing
from tests.journeys.agent_directed import make_project

pytestmark = pytest.mark.journey


def test_a_procedure_finds_a_hidden_cube_and_a_liar_ends_failed(tmp_path):
    project = make_project(tmp_path / "project")
    workspace = open_project(tmp_path / "w", project)
    with open_bench(workspace, SystemClock(), sense=Sensing.PERCEIVED, memory_use=MemoryUse.NONE) as agent:
        honest, liar = (
            agent.mission.run(project / "goal_graphs" / f"{name}.yaml", seed=1, goal=f"{name}-1")
            for name in ("scripted", "liar")
        )
    first, claimed = honest.sessions[0], liar.sessions[0]
    assert (honest.verdict, len(honest.sessions)) == ("success", 1), honest
    assert is_in_tray(workspace.evidence_of(first.id), "green_cube", "green_tray")
    assert liar.verdict == "failure"
    assert (claimed.ended, claimed.verdict) == ("completed", "replan"), "what it claims is recorded and not believed"
