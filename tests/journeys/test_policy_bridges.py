"""Every action bridge carries a policy on physics: one motion of the tool, said in six languages, is that motion."""

import json

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.action_spaces import ActionSpace, describe_target_space
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.capabilities.registries import read_target_registry
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.actions.bridges.chain import compile_chain, list_bridges
from phyagentos.runtime.actions.bridges.tool_poses import describe_frames
from phyagentos.runtime.policies.exchanges import read_arrays, read_exchanges, replay_exchanges
from phyagentos.runtime.policies.openpi_server import serve_openpi
from tests.policies import STATE, STREAM, serve, show_tool_pose, write_arm, write_policy_skill

pytestmark = pytest.mark.journey

WAY_M, TURN_RAD, WIDTH_M = np.array([0.03, -0.02, 0.05]), 0.2, 0.04  # of the tool, in the world; about its vertical
JOINTS_RAD = np.array([0.05, -0.04, 0.03, 0.06, -0.05, 0.04, 0.1])  # of those who speak of joints
ROWS = 20  # of the whole motion, at 10 Hz
FAST = 6  # of one that only a spline between its rows makes smooth enough
MOUNT = Rotation.from_rotvec([0.0, 0.0, 0.3]).as_quat(scalar_first=True).round(6).tolist()
POSE = {"representation": "tool_pose", "rate_hz": 10, "chunk_length": ROWS}
ARM = [f"joint{index}" for index in range(1, 8)]
SPACES = {
    "six_joints": {
        "representation": "joint_position", "joints": [*ARM[:6], "rail"], "drop": ["rail"], "fixed": {"joint7": 0.785},
        "delta": True, "clamp": True, "rate_hz": 10, "chunk_length": ROWS, "gripper": {"closed": 0.0, "open": 1.0},
    },
    "quaternions": POSE | {"rate_hz": 50, "chunk_length": 100, "gripper": {"closed": 0.0, "open": 0.08}},
    "scaled_changes": POSE
    | {"delta": True, "frame": "base", "rotation": "axis_angle", "scale": [0.05] * 3 + [0.5] * 3}
    | {"gripper": {"closed": 1.0, "open": -1.0}},
    "millimetres": POSE
    | {"length_unit": "mm", "rotation": "euler", "euler_order": "ZYX", "angle_unit": "deg", "frame": "base"}
    | {"gripper": {"closed": 0.0, "open": 1.0}},
    "columns": POSE
    | {"rotation": "rotation_6d", "interpolation": "cubic", "chunk_length": FAST}
    | {"gripper": {"closed": 255, "open": 0}},
    "reversed_degrees": {
        "representation": "joint_position", "joints": ARM[::-1], "angle_unit": "deg", "rate_hz": 25, "chunk_length": 50,
        "gripper": {"closed": 1.0, "open": 0.0},
    },
}  # fmt: skip
POLICY = {
    "policy": "mover/1",
    "observations": {
        "joint_state": STREAM,
        "tool_pose": STATE | {"shape": [7]},
        "gripper_width": STATE | {"unit": "m"},
    },
    "inference_s": 0.1,
    "execution": {"mode": "open_loop"},
}


class Mover:
    """Says the motion in the language that its session names."""

    def start(self, request):
        self.space = SPACES[request.parameters["language"]]

    def infer(self, request):
        space, shown = self.space, request.observations
        count = space["chunk_length"]
        s = np.linspace(0.0, 1.0, count + 1)[:, None]
        share = 10 * s**3 - 15 * s**4 + 6 * s**5
        gripper = space["gripper"]
        opening = gripper["closed"] + WIDTH_M / 0.08 * (gripper["open"] - gripper["closed"])
        arm = (
            self.say_joints(shown["joint_state"], share)
            if "joints" in space
            else self.say_poses(shown["tool_pose"], share)
        )
        return np.hstack((arm, np.full((count, 1), opening))), True

    def say_joints(self, q, share):
        joints = q + share * JOINTS_RAD
        if self.space.get("delta"):
            return np.hstack((np.diff(joints[:, :6], axis=0), np.full((len(share) - 1, 1), 9.9)))
        return np.degrees(joints[1:, ::-1])

    def say_poses(self, pose, share):
        space, base = self.space, Rotation.identity()
        if space.get("frame") == "base":
            base = Rotation.from_quat(MOUNT, scalar_first=True).inv()
        turns = (
            base * Rotation.from_rotvec(share * [0.0, 0.0, TURN_RAD]) * Rotation.from_quat(pose[3:], scalar_first=True)
        )
        places = base.apply(pose[:3] + share * WAY_M)
        if space.get("delta"):
            turned = (turns[1:] * turns[:-1].inv()).as_rotvec()
            return np.hstack((np.diff(places, axis=0) / 0.05, turned / 0.5))
        forms = {
            "quaternion_wxyz": lambda: turns.as_quat(scalar_first=True),
            "euler": lambda: turns.as_euler("ZYX", degrees=True),
            "rotation_6d": lambda: np.hstack((turns.as_matrix()[:, :, 0], turns.as_matrix()[:, :, 1])),
        }
        unit = 1000.0 if space.get("length_unit") == "mm" else 1.0
        return np.hstack((unit * places, forms[space.get("rotation", "quaternion_wxyz")]()))[1:]


def make_project(root, endpoint):
    write_arm(root, mount_quaternion_wxyz=MOUNT)  # so that its base's frame is not the world's
    for name, space in SPACES.items():
        front = {
            "skill": name,
            "description": "Moves the tool.",
            "kind": "policy",
            "parameters": {"language": {"type": "string"}},
            "action_space": space,
            "policy": POLICY | {"endpoint": endpoint},
        }
        write_policy_skill(root, front)
    accept = ["not moved(red_cube)", "metric(final_rest_s) >= 0.05"]
    graph = {"goal": "speak", "objective": "Move.", "scene": "tabletop/cubes_and_trays", "targets": {"arm": "panda"}}
    graph["defaults"] = {"timeout_s": 20, "max_replans": 0}
    graph["sessions"] = {
        name: {"skill": name, "target": "arm", "with": {"language": name}, "accept": accept, "after": [*SPACES][:index]}
        for index, name in enumerate(SPACES)
    }
    (root / "speak.yaml").write_text(yaml.safe_dump(graph))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    root = tmp_path_factory.mktemp("bridges")
    descriptor = PolicyDescriptor.model_validate(POLICY | {"endpoint": "openpi://127.0.0.1:0"})
    make_project(root, serve(serve_openpi, Mover(), descriptor))
    workspace = Workspace.create(root / "w", Library.open(root))
    show_tool_pose(workspace)
    with open_bench(workspace, SystemClock(), memory_use=MemoryUse.NONE) as agent:
        report = agent.mission.run(root / "speak.yaml", seed=1)
    return workspace, {session.id.rpartition(".")[2]: session for session in report.sessions}


@pytest.mark.parametrize("language", SPACES)
def test_a_motion_of_the_tool_is_the_same_in_every_language(run, language):
    workspace, sessions = run
    session = sessions[language]
    folder = workspace.evidence_of(session.id)
    assert (session.ended, session.verdict) == ("completed", "success"), session
    before, after = (
        json.loads((folder / name).read_bytes())["targets"]["panda"] for name in (evidence.BEFORE, evidence.AFTER)
    )
    assert after["gripper_width_m"] == pytest.approx(WIDTH_M, abs=2e-3)
    moved_rad = np.subtract(after["q_rad"], before["q_rad"])
    if language == "reversed_degrees":
        assert moved_rad == pytest.approx(JOINTS_RAD, abs=3e-3)
    elif language == "six_joints":
        assert moved_rad[:6] == pytest.approx(JOINTS_RAD[:6], abs=3e-3)
    else:
        moved_m = np.subtract(after["tcp"]["position_m"], before["tcp"]["position_m"])
        assert moved_m == pytest.approx(WAY_M, abs=2e-3)
        turns = [Rotation.from_quat(each["tcp"]["quaternion_wxyz"], scalar_first=True) for each in (before, after)]
        assert (turns[1] * turns[0].inv()).as_rotvec() == pytest.approx([0.0, 0.0, TURN_RAD], abs=0.01)


def test_what_was_shown_can_be_shown_to_the_server_again(run):
    workspace, sessions = run
    session = sessions["columns"].id
    folder = workspace.evidence_of(session)
    (exchange,) = read_exchanges(folder)
    arrays, rows = read_arrays(folder, exchange)
    assert set(arrays) == set(POLICY["observations"])
    assert rows.shape == (FAST, 10)
    (same,) = replay_exchanges(workspace.root, session)
    assert same.is_same, same
    WAY_M[2] += 0.01  # the served policy is another one now
    (other,) = replay_exchanges(workspace.root, session)
    WAY_M[2] -= 0.01
    assert (other.is_same, other.difference) == (False, pytest.approx(0.01))
    assert other.where == (FAST - 1, 2)


def test_these_languages_need_every_bridge(run):
    workspace, _ = run
    profile = read_target_registry(workspace.target_registry)["panda"]
    target, frames = describe_target_space(profile), describe_frames(profile)
    chains = [compile_chain(ActionSpace.model_validate(space), target, frames) for space in SPACES.values()]
    used = {type(link) for chain in chains for link in chain.links}
    assert used == set(list_bridges())
