"""A policy that is an ONNX model, in this process; `make test-extras` installs what these need."""

import contextlib
import sys

import numpy as np
import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import locate_models
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.client import PolicyClient, ask_policy
from tests.policies import STREAM, describe, take

STREAMS = describe("onnx:line.onnx", observations={"joint_state": STREAM | {"key": "state"}}).observations
SKILL = """---
skill: line
description: Follows a line.
kind: policy
action_space: {representation: joint_position, joints: [a, b], rate_hz: 50}
policy:
  policy: line/1
  endpoint: onnx:line.onnx
  observations: {joint_state: {modality: proprioception, shape: [n_joints], rate_hz: 50}}
  inference_s: 0.1
---
# Line
"""


def ask(endpoint, name="joint_state"):
    with contextlib.closing(PolicyClient(endpoint, 5.0, STREAMS)) as client:
        request = wire.Infer("s", 0, 0, 0.0, {name: np.array([0.1, 0.2])})
        client.ask(request, wire.Start("s", "go", {}, 7))
        return take(client)


@pytest.fixture
def model(tmp_path):
    """state (batch, 2) -> actions (batch, 3, 2): the state, and one and two hundredths beyond; done is false."""
    pytest.importorskip("onnxruntime", reason="no onnxruntime and onnx here: `make test-extras`")
    onnx = pytest.importorskip("onnx", reason="no onnxruntime and onnx here: `make test-extras`")
    from onnx import TensorProto, helper, numpy_helper

    steps = numpy_helper.from_array(np.array([[[0.0], [0.01], [0.02]]], dtype=np.float32), "steps")
    axis = numpy_helper.from_array(np.array([1], dtype=np.int64), "axis")
    nodes = [
        helper.make_node("Unsqueeze", ["state", "axis"], ["row"]),
        helper.make_node("Add", ["row", "steps"], ["actions"]),
    ]
    graph = helper.make_graph(
        nodes,
        "line",
        [helper.make_tensor_value_info("state", TensorProto.FLOAT, ["batch", 2])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, ["batch", 3, 2])],
        [steps, axis],
    )
    path = tmp_path / "line.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def test_a_model_is_shown_its_inputs_and_gives_a_chunk(model):
    chunk = ask(f"onnx:{model}")
    assert chunk.rows == pytest.approx(np.array([[0.1, 0.2], [0.11, 0.21], [0.12, 0.22]]), abs=1e-6)
    assert chunk.done is False
    assert np.array_equal(chunk.rows, ask(f"onnx:{model}").rows), "the same bits"
    assert ask_policy(f"onnx:{model}") is None, "it says nothing of itself"


def test_what_is_no_model_is_told(model):
    model.write_bytes(b"words")
    with pytest.raises(ExecutionError, match=r"POLICY_UNREACHABLE: .*is no model that runs here"):
        ask(f"onnx:{model}")


def test_without_onnxruntime_it_says_which_extra_brings_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ExecutionError, match=r"POLICY_UNREACHABLE: .*pip install '\.\[onnx\]'"):
        ask(f"onnx:{tmp_path}/line.onnx")


def test_a_model_is_found_beside_its_skill(tmp_path):
    path = tmp_path / "skills" / "line" / "SKILL.md"
    path.parent.mkdir(parents=True)
    path.write_text(SKILL)
    skill, _ = read_skill(path)
    (located,) = locate_models({"line": skill}, Library.open(tmp_path)).values()
    assert located.policy.endpoint == f"onnx:{path.with_name('line.onnx')}"
