"""Repair on the real path, in the smallest size of its benchmark."""

from pathlib import Path

import pytest

from benchmarks.oracle.conditions import is_so
from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.scorers.simulator_state import is_in_tray
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.settings.perception import Sensing

ROOT = Path(__file__).resolve().parents[2]
PARTS = ROOT / "benchmarks" / "recovery_parts"

pytestmark = pytest.mark.journey


def test_a_hemmed_in_cube_and_a_carton_too_wide_are_had_by_clearing_and_by_pushing(tmp_path):
    workspace = open_project(tmp_path / "w", ROOT)
    with open_bench(workspace, SystemClock(), sense=Sensing.TRUTH, memory_use=MemoryUse.NONE) as agent:
        hemmed, wide = (
            agent.mission.run(PARTS / f"{case}.yaml", seed=400, goal=f"{case}-400") for case in ("hemmed", "wide")
        )
    ends = [workspace.evidence_of(report.sessions[-1].id) for report in (hemmed, wide)]

    assert (hemmed.verdict, wide.verdict) == ("success", "success"), (hemmed, wide)
    assert is_in_tray(ends[0], "red_cube", "red_tray")
    assert is_so(ends[1], "inside(carton, zone)", zone=((0.5, -0.32, 0.15), (0.08, 0.08, 0.15)))
    assert "flowchart TD" in (document := (workspace.root / "TASK.md").read_text())
    assert '-- "clears" -->' in document
