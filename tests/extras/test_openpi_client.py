"""openpi's own client, in the environment of `--openpi-python`, asks what `paos policy serve` serves."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.extras

SKILL = """---
skill: echo
description: Answers with what it is shown.
kind: policy
action_space: {representation: joint_position, joints: [a, b, c], rate_hz: 50, chunk_length: 2}
policy:
  policy: echo/1
  endpoint: openpi://127.0.0.1:0
  observations: {joint_state: {modality: proprioception, shape: [n_joints], rate_hz: 50, key: observation/state}}
  inference_s: 0.1
---
# Echo
"""
MODEL = """
import numpy as np

class Echo:
    def start(self, request):
        self.words = request.instruction

    def infer(self, request):
        state, image = request.observations["observation/state"], request.observations["observation/image"]
        assert image.dtype == np.uint8 and image.shape == (224, 224, 3), image.shape
        if not np.isfinite(state).all():
            raise ValueError("cannot see, " + self.words)
        return np.stack((state, 2 * state)), False
"""
CLIENT = """
import json, sys
import numpy as np
from openpi_client.action_chunk_broker import ActionChunkBroker
from openpi_client.websocket_client_policy import WebsocketClientPolicy

policy = WebsocketClientPolicy("127.0.0.1", int(sys.argv[1]))
image = np.zeros((224, 224, 3), dtype=np.uint8)
show = lambda state: {"observation/state": np.array(state, np.float32), "observation/image": image, "prompt": "go"}
answer = policy.infer(show([1, 2, 3]))
broker = ActionChunkBroker(policy, action_horizon=2)
steps = [broker.infer(show([4, 5, 6]))["actions"].tolist() for _ in range(2)]
try:
    policy.infer(show([np.nan, 0, 0]))
    error = ""
except RuntimeError as raised:
    error = str(raised)
told = {"metadata": sorted(policy.get_server_metadata()), "actions": answer["actions"].tolist(), "steps": steps}
print(json.dumps(told | {"timed": "infer_ms" in answer["server_timing"], "error": error}))
"""


def test_openpis_own_client_is_served(tmp_path, pytestconfig):
    skill = tmp_path / "skills" / "echo" / "SKILL.md"
    skill.parent.mkdir(parents=True)
    skill.write_text(SKILL)
    (tmp_path / "model.py").write_text(MODEL)
    command = [sys.executable, "-m", "phyagentos", "policy", "serve", str(skill), f"{tmp_path}/model.py:Echo"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            port = server.stdout.readline().strip().rpartition(":")[2]
            client = [pytestconfig.option.openpi_python, "-c", CLIENT, port]
            done = subprocess.run(client, capture_output=True, text=True, timeout=60, check=False)
        finally:
            server.kill()
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["metadata"] == ["descriptor", "phyagentos"]
    assert told["actions"] == [[1, 2, 3], [2, 4, 6]]
    assert told["steps"] == [[4, 5, 6], [8, 10, 12]]
    assert told["timed"]
    assert "cannot see, go" in told["error"]
