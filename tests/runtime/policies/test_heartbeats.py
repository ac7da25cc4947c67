"""A policy server that stalls is named within its limit; one that is at work, or idle, is not."""

import os
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.client import PolicyClient
from phyagentos.runtime.policies.openpi_server import serve_openpi
from phyagentos.runtime.policies.policy_server import serve_policy
from tests.policies import describe, serve, take

CLOCK = SystemClock()
HEARTBEAT_S, INFERENCE_S = 0.2, 0.1
SKILL = """---
skill: echo
description: Answers with what it is shown.
kind: policy
action_space: {representation: joint_position, joints: [a, b], rate_hz: 50}
policy:
  policy: echo/1
  endpoint: openpi://127.0.0.1:0
  observations: {joint_state: {modality: proprioception, shape: [n_joints], rate_hz: 50}}
  inference_s: 0.1
---
# Echo
"""
MODEL = """
class Echo:
    def start(self, request):
        pass

    def infer(self, request):
        return request.observations["joint_state"][None], False
"""


class Slow:
    """Thinks for longer than it may be silent."""

    def start(self, request):
        pass

    def infer(self, request):
        CLOCK.sleep(3 * (HEARTBEAT_S + INFERENCE_S))
        return request.observations["joint_state"][None], False


def open_client(endpoint, timeout_s=10.0):
    return PolicyClient(endpoint, timeout_s, describe().observations, HEARTBEAT_S, INFERENCE_S)


def ask(client, sequence=0):
    request = wire.Infer("s", sequence, 0, 0.0, {"joint_state": np.zeros(2)})
    client.ask(request, None if sequence else wire.Start("s", "go", {}, 7))
    return take(client)


def watch(client, for_s):
    """Look after an idle server for so long."""
    end_s = CLOCK.now_s() + for_s
    while CLOCK.now_s() < end_s:
        client.watch()
        CLOCK.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("serve_so", "scheme"), [(serve_policy, "tcp"), (serve_openpi, "openpi")])
def test_a_server_that_is_at_work_for_long_is_waited_for(serve_so, scheme):
    client = open_client(serve(serve_so, Slow(), describe(f"{scheme}://127.0.0.1:0")))
    assert ask(client).rows.shape == (1, 2)
    watch(client, 3 * HEARTBEAT_S)  # idle, and alive
    client.close()


def test_one_that_gives_no_sign_of_life_in_the_midst_of_a_request_is_named_long_before_the_contract_ends():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        where, began_s = f"tcp://127.0.0.1:{listener.getsockname()[1]}", CLOCK.now_s()
        client = open_client(where)
        with pytest.raises(ExecutionError, match=rf"{where}: .*sent nothing for 0\.3 s; heartbeat_s: 0\.2") as error:
            ask(client)
        client.close()
    assert error.value.code == "POLICY_LOST"
    assert CLOCK.now_s() - began_s < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["tcp", "openpi"])
def test_a_served_process_that_is_stopped_is_named_between_two_requests(tmp_path, scheme):
    skill = tmp_path / "skills" / "echo" / "SKILL.md"
    skill.parent.mkdir(parents=True)
    skill.write_text(SKILL)
    (tmp_path / "model.py").write_text(MODEL)
    command = [sys.executable, "-m", "phyagentos", "policy", "serve", str(skill), f"{tmp_path}/model.py:Echo"]
    command += ["--endpoint", f"{scheme}://127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            client = open_client(server.stdout.readline().removeprefix("serving at ").strip())
            ask(client)
            os.kill(server.pid, signal.SIGSTOP)
            began_s = CLOCK.now_s()
            with pytest.raises(ExecutionError, match=f"POLICY_LOST: .*{scheme}://127"):
                watch(client, 5.0)
            assert CLOCK.now_s() - began_s < HEARTBEAT_S + 0.5
            client.close()
        finally:
            server.kill()
