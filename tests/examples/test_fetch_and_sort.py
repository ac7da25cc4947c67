"""Example 7: a cart fetches cubes from afar and an arm sorts them, in one world and under one goal."""

import json
import shutil

import numpy as np
import pytest

from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.assembly.paths import open_project
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import find_shipped_root
from tests.models_here import read_profile_here

EXAMPLE = find_shipped_root() / "examples" / "projects" / "07_fetch_and_sort"


@pytest.mark.journey
def test_while_the_cart_is_away_for_the_second_cube_the_arm_sorts_the_first_and_they_never_touch(tmp_path):
    read_profile_here("xlerobot")
    project = shutil.copytree(EXAMPLE, tmp_path / "project")
    workspace = open_project(tmp_path / "w", project)
    with open_bench(workspace, SystemClock(), memory_use=MemoryUse.NONE) as agent:
        report = agent.mission.run(project / "goal_graphs" / "fetch_and_sort.yaml", seed=1)
    folders = {each.node: workspace.evidence_of(each.id) for each in report.sessions}
    events = [
        json.loads(line) for each in folders.values() for line in (each / "events.jsonl").read_text().splitlines()
    ]
    spans = {
        node: [float(np.load(folder / f"{moment}.npz")["time"]) for moment in ("initial", "terminal")]
        for node, folder in folders.items()
    }

    assert report.verdict == "success", report
    assert not [event for event in events if event["kind"] == "robot_contact"]
    assert spans["bring_red"][1] <= spans["sort_red"][0]  # an edge
    assert spans["sort_red"][1] <= spans["bring_blue"][0]  # they take turns at the counter
    apart = {"find_blue", "take_blue", "carry_blue"}
    assert any(spans["sort_red"][0] < spans[node][1] and spans[node][0] < spans["sort_red"][1] for node in apart)
    makespan_s = max(end for _, end in spans.values()) - min(start for start, _ in spans.values())
    assert makespan_s < 0.9 * sum(session.sim_time_s for session in report.sessions)
