"""A policy that comes down beside the object: its next attempt begins at home, and with the object shown aside."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.policies.exchanges import read_arrays, read_exchanges
from phyagentos.runtime.policies.policy_server import serve_policy
from tests.policies import STATE, serve, show_tool_pose, write_arm, write_policy_skill

pytestmark = pytest.mark.journey

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "projects" / "10_train_policy"
ERROR_M = np.array([-0.022, 0.018, 0.0])  # of what it has learned
WAY = ((80, 0.1), (50, 0.0))  # rows, and the height over the object after them [m]
CLOSE, LIFT, CHUNK = 30, 40, 100
SKILL = {
    "skill": "grip",
    "description": "Takes hold of a thing.",
    "kind": "policy",
    "parameters": {"object": {"type": "entity"}, "aim": {"type": "point", "optional": True}},
    "action_space": {
        "representation": "tool_pose", "rate_hz": 50, "chunk_length": CHUNK, "gripper": {"closed": 0.0, "open": 0.08},
    },
    "policy": {
        "policy": "grip/1",
        "observations": {
            "tool_pose": STATE | {"shape": [7]},
            "environment_state": STATE | {"modality": "simulator_state", "shape": [1, 7], "entities": ["object"]},
        },
        "inference_s": 0.1,
        "execution": {"mode": "open_loop", "begins_after": "start_over", "aim": "aim"},
    },
}  # fmt: skip
GRAPH = {
    "goal": "grip",
    "objective": "Hold the cube.",
    "scene": "one_cube",
    "targets": {"arm": "panda"},
    "defaults": {"timeout_s": 20, "max_replans": 1},
    "sessions": {
        "cube": {"skill": "grip", "target": "arm", "with": {"object": "cube"}, "accept": ["holding(arm, cube)"]},
    },
}

HELD = GRAPH | {
    "goal": "held",
    "sessions": {
        "pick": {"skill": "pick", "target": "arm", "with": {"object": "cube"}, "accept": ["height(cube) < 0.15"]},
        "again": {
            "skill": "start_over", "target": "arm", "with": {"object": "cube"}, "after": ["pick"],
            "accept": ["holding(arm, cube)", "height(cube) > 0.15"],
        },
    },
}  # fmt: skip


class Gripping:
    """Comes down beside what it is shown, by the same error each time, closes and lifts."""

    def start(self, request):
        self.rows = None

    def infer(self, request):
        if self.rows is None:
            self.rows = self.plan(request)
        begin, end = request.rows_done, request.rows_done + CHUNK
        return self.rows[begin:end], end >= len(self.rows)

    def plan(self, request):
        tool, (item,) = request.observations["tool_pose"], request.observations["environment_state"]
        places = [tool[:3], *(item[:3] + ERROR_M + (0.0, 0.0, up_m) for _, up_m in WAY)]
        legs = [*zip(places, places[1:], [rows for rows, _ in WAY], strict=False)]
        legs += [(places[-1], places[-1], CLOSE), (places[-1], places[-1] + (0.0, 0.0, 0.08), LIFT)]
        rows = np.vstack([start + smooth(count) * (end - start) for start, end, count in legs])
        opening = np.where(np.arange(len(rows)) < sum(count for count, _ in WAY), 0.08, 0.0)
        return np.column_stack((rows, np.tile(tool[3:], (len(rows), 1)), opening))


def smooth(count):
    s = np.linspace(0.0, 1.0, count + 1)[1:, None]
    return 10 * s**3 - 15 * s**4 + 6 * s**5


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    root = tmp_path_factory.mktemp("next_attempt")
    write_arm(root)
    policy = SKILL["policy"] | {"endpoint": "tcp://127.0.0.1:0"}
    policy["endpoint"] = serve(serve_policy, Gripping(), PolicyDescriptor.model_validate(policy))
    write_policy_skill(root, SKILL | {"policy": policy})
    for each in (GRAPH, HELD):
        (root / f"{each['goal']}.yaml").write_text(yaml.safe_dump(each))
    workspace = Workspace.create(root / "w", Library.open(root, EXAMPLE))
    show_tool_pose(workspace)
    with open_bench(workspace, SystemClock(), memory_use=MemoryUse.NONE) as agent:
        return workspace, *(agent.mission.run(root / f"{each['goal']}.yaml", seed=1) for each in (GRAPH, HELD))


def test_what_is_in_the_hand_is_kept_and_lifted(run):
    _, _, report = run
    assert [each.verdict for each in report.sessions] == ["success", "success"], report


def test_the_next_attempt_takes_hold_of_what_the_first_came_down_beside(run):
    workspace, report, _ = run
    assert [(each.skill, each.verdict) for each in report.sessions] == [
        ("grip", "replan"), ("start_over", "success"), ("grip", "success"),
    ], report  # fmt: skip
    assert report.replans == 1, "to begin anew is no attempt"
    first, _, last = report.sessions
    tools, asides = [], []
    for each in (first, last):
        folder = workspace.evidence_of(each.id)
        shown, _ = read_arrays(folder, next(iter(read_exchanges(folder))))
        believed = json.loads((folder / evidence.BEFORE).read_bytes())["entities"]["cube"]["pose"]["position_m"]
        tools.append(shown["tool_pose"][:3])
        asides.append(shown["environment_state"][0, :3] - believed)
    assert tools[1] == pytest.approx(tools[0], abs=0.01), "it began where the first one had begun"
    assert asides[0] == pytest.approx(0.0)
    assert asides[1] == pytest.approx(-ERROR_M, abs=0.008), "and saw the cube aside"
