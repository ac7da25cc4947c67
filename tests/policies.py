"""Policies that are served in a thread of this process, clients that wait for their chunk, and an arm that they see."""

import queue
import shutil
import threading

import yaml

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor

STATE = {"modality": "proprioception", "dtype": "float64", "rate_hz": 50}
STREAM = STATE | {"shape": ["n_joints"], "unit": "rad"}
SENSED = "provides: [joint_state, gripper_width]\n    signals:\n"
SENSED_TOO = "provides: [joint_state, gripper_width, tool_pose]\n    signals:\n      tool_pose: {shape: [7]}\n"


def describe(endpoint="tcp://127.0.0.1:0", **changes):
    """A policy that is shown the joints."""
    described = {"policy": "echo/1", "endpoint": endpoint, "observations": {"joint_state": STREAM}, "inference_s": 0.1}
    return PolicyDescriptor.model_validate(described | changes)


def serve(serve_so, policy, descriptor):
    """Serve a policy by `serve_policy` or `serve_openpi` until this process ends; the endpoint."""
    found = queue.SimpleQueue()
    threading.Thread(target=serve_so, args=(policy, descriptor, found.put), daemon=True).start()
    return found.get(timeout=10.0)


def take(client):
    """The chunk that a client has requested."""
    while (chunk := client.poll()) is None:
        client.wait(1.0)
    return chunk


def write_arm(root, **changes):
    """The shipped arm in a project, offering the pose of its tool besides."""
    robot = shutil.copytree(find_shipped_root() / "robots" / "panda", root / "robots" / "panda")
    profile = yaml.safe_load((robot / "target.yaml").read_text())
    observations = [*profile["observations"], "tool_pose"]
    (robot / "target.yaml").write_text(yaml.safe_dump(profile | {"observations": observations} | changes))


def show_tool_pose(workspace):
    """Let the arm's own sensor give the pose of its tool."""
    sensors = workspace.sensors.read_text()
    assert SENSED in sensors
    workspace.sensors.write_text(sensors.replace(SENSED, SENSED_TOO))


def write_policy_skill(root, front):
    """The document of a skill in a project."""
    path = root / "skills" / front["skill"] / "SKILL.md"
    path.parent.mkdir(parents=True)
    path.write_text(f"---\n{yaml.safe_dump(front)}---\n# {front['skill']}\n")
