"""What was verified on one seed helps on another, on the real path, and is gone with the memory."""

from pathlib import Path

import pytest
import yaml

from benchmarks.oracle.conditions import is_in_place
from phyagentos.assembly.agent_plane import MemoryUse, open_agent
from phyagentos.assembly.paths import open_project
from phyagentos.assembly.planes import start_watch
from phyagentos.clock import SystemClock
from phyagentos.protocol.settings.perception import Sensing

ROOT = Path(__file__).resolve().parents[2]
BENCH = ROOT / "benchmarks" / "evolution_parts" / "workbench.yaml"
IN_TRAY = {"center_m": (0, 0, 0.02), "half_m": (0.055, 0.09, 0.015)}

pytestmark = pytest.mark.journey


@pytest.fixture
def soap(tmp_path):
    """The bench of the suite `evolution` with one of its traps: soap that slips at full speed."""
    graph = yaml.safe_load(BENCH.read_text())
    graph["sessions"] = {"soap": graph["sessions"]["soap"]}
    path = tmp_path / "workbench.yaml"
    path.write_text(yaml.safe_dump(graph))
    return path


def test_a_seed_that_was_learned_from_helps_on_another_and_the_gain_goes_with_the_memory(tmp_path, soap):
    workspace, clock, once = open_project(tmp_path / "w", ROOT), SystemClock(), {"defaults.max_replans": "0"}

    def run(goal, seed, use, overrides=None):
        with open_agent(workspace, clock, by="bench", memory_use=use, is_runtime_alive=plane.is_alive) as agent:
            report = agent.mission.run(soap, seed=seed, goal=goal, overrides=overrides)
            first, *_ = report.sessions
            is_there = is_in_place(workspace.evidence_of(first.id), "soap", "left_tray", **IN_TRAY)
            assert (first.state == "succeeded") == is_there, "no verdict that the world denies"
            return is_there, bool(agent.mission.ledger.sessions[first.id].contract.advised_by), report.verdict

    with start_watch(workspace, pictures=False, sense=Sensing.PERCEIVED).running(clock) as plane:
        assert run("adaptation", 0, MemoryUse.LEARN)[2] == "success"
        assert run("after", 1, MemoryUse.READ, once) == (True, True, "success")
        workspace.memory.rename(tmp_path / "memory-set-aside")
        assert run("emptied", 1, MemoryUse.READ, once) == (False, False, "failure")
