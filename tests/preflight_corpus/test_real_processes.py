"""The same misconfigurations against the real processes: both planes, a simulated arm, and its own receive log."""

import json
import re

import pytest

from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.workspace.workspace import Workspace

from .corpus import Edit, make_project

GRAPH = find_shipped_root() / "goal_graphs" / "tidy_table.yaml"
FAR_CUBE = Edit(
    file="scenes/tabletop/cubes_and_trays.yaml",
    path=("bodies", "red_cube", "place"),
    value={"position_m": [1.9, 0.0, 0.03]},
)
CLOSED_TRAY = Edit(
    file="protocol/safety.yaml",
    path=("targets", "panda", "keep_out", "blue_tray"),
    value={
        "value": [[0.57, 0.26, -0.02], [0.73, 0.52, 0.30]],
        "unit": "m",
        "source": "Site policy: the blue tray is of another arm",
        "provenance": "site_policy",
    },
)


def run(root, edits, rename=("", "")):
    """A mission in a project with these edits: its report, codes of the reject records, what the target took."""
    workspace = Workspace.create(root / "w", make_project(root / "project", edits))
    if rename[0]:
        text = workspace.target_registry.read_text(encoding="utf-8")
        workspace.target_registry.write_text(text.replace(*rename), encoding="utf-8")
    with open_bench(workspace, SystemClock()) as agent:
        report = agent.mission.run(GRAPH, seed=1, goal="tidy")
    reasons = {id: status.reason for id, status in agent.mission.ledger.sessions.items() if status.state == "rejected"}
    codes = {id: set(re.findall(r": ([A-Z]+(?:_[A-Z]+)+)\b", reason)) for id, reason in reasons.items()}
    received = workspace.logs / "receive-panda.jsonl"
    lines = received.read_text(encoding="utf-8").splitlines() if received.exists() else []
    return report, codes, [json.loads(line) for line in lines]


@pytest.mark.journey
def test_a_real_robot_without_a_driver_is_refused_before_anything_starts(tmp_path):
    report, codes, received = run(tmp_path, (), ("target: panda\n", "target: panda\nkind: real_robot\n"))

    assert report.exit_code == 3
    assert codes == {f"tidy.{node}": {"NO_DRIVER"} for node in ("red", "green", "blue")}
    assert received == []
    assert not [*(tmp_path / "w" / "logs").glob("world-*.log")]


@pytest.mark.journey
def test_an_object_out_of_reach_and_a_place_beyond_the_workspace_stop_only_their_own_sessions(tmp_path):
    report, codes, received = run(tmp_path, [FAR_CUBE, CLOSED_TRAY])

    assert codes == {"tidy.red": {"OUT_OF_REACH"}, "tidy.blue": {"OUT_OF_REACH"}}
    assert report.exit_code == 3
    assert report.first_attempt_success == {"red": False, "green": True, "blue": False}
    assert not [line for line in received if line.get("session") in {"tidy.red", "tidy.blue"}]
    assert [line for line in received if line.get("session") == "tidy.green"]
