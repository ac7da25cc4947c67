"""LeRobot's own policy server behind `kits/lerobot_bridge`, both in the environment of `--lerobot-python`."""

import contextlib
import json
import os
import pickle
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from phyagentos.assembly.agent_plane import MemoryUse
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.policy_descriptors import Stream
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.client import PolicyClient, ask_policy
from phyagentos.runtime.policies.exchanges import read_exchanges

pytestmark = [pytest.mark.extras, pytest.mark.journey]

HERE = Path(__file__).parent
BRIDGE = HERE.parents[1] / "kits" / "lerobot_bridge" / "lerobot_bridge.py"
CLOCK = SystemClock()
START_S, TIMEOUT_S, HEARTBEAT_S = 300.0, 10, 4.0
RATE = {"dtype": "float64", "rate_hz": 50}
STREAMS = {
    "joint_state": Stream(modality="proprioception", shape=("n_joints",), key="observation.state", **RATE),
    "camera_rgb": Stream(modality="rgb", shape=(64, 64, 3), dtype="uint8", rate_hz=25, key="observation.images.front"),
}
SHOWN = {
    "joint_state": np.linspace(-0.5, 0.5, 7),
    "camera_rgb": np.random.default_rng(3).integers(0, 256, (64, 64, 3), dtype=np.uint8),
}
NEAR = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.08])  # at home, open
SKILL = {
    "skill": "stay",
    "description": "Stays.",
    "kind": "policy",
    "action_space": {
        "representation": "joint_position",
        "joints": [f"joint{index}" for index in range(1, 8)],
        "rate_hz": 50,
        "chunk_length": 12,
        "gripper": {"closed": 0.0, "open": 0.08},
    },
    "policy": {
        "policy": "act/1",
        "observations": {
            "joint_state": {"modality": "proprioception", "shape": ["n_joints"], "dtype": "float64", "unit": "rad"}
            | {"rate_hz": 50, "key": "observation.state"},
            "camera_rgb": {"modality": "rgb", "frame": "overhead", "shape": [144, 192, 3], "dtype": "uint8"}
            | {"rate_hz": 25, "key": "observation.images.front", "resize": [64, 64]},
        },
        "inference_s": 0.2,
        "execution": {"mode": "open_loop", "duration_s": 0.5},
    },
}
GRAPH = {
    "goal": "rest",
    "objective": "Stay.",
    "scene": "tabletop/cubes_and_trays",
    "targets": {"arm": "panda"},
    "sessions": {"stay": {"skill": "stay", "target": "arm", "accept": ["not moved(red_cube)"]}},
}
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": ""}


class Systems:
    """LeRobot's policy server and the bridge, with what they say in files of their own."""

    def __init__(self, python, folder):
        self.python, self.folder = python, folder
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.address = f"127.0.0.1:{free.getsockname()[1]}"

    def command(self, *arguments):
        return [self.python, str(HERE / "with_lerobot.py"), *map(str, arguments)]

    def start_server(self):
        host, port = self.address.split(":")
        given = ["lerobot.async_inference.policy_server", f"--host={host}", f"--port={port}", "--fps=50"]
        with (self.folder / "server.log").open("ab") as log:
            self.server = subprocess.Popen(
                self.command(*given), cwd=self.folder, stdout=log, stderr=log, env=ENVIRONMENT
            )
        self.wait_until(self.is_listening, self.server)

    def start_bridge(self):
        policy = ["act", self.folder / "act", "--state", 7, "--camera", "front=64x64"]
        given = [BRIDGE, *policy, "--server", self.address, "--port", 0, "--timeout", TIMEOUT_S]
        path = self.folder / "bridge.log"
        with path.open("wb") as log:
            self.bridge = subprocess.Popen(
                self.command(*given), cwd=self.folder, stdout=log, stderr=log, env=ENVIRONMENT
            )
        self.wait_until(lambda: b"openpi://" in path.read_bytes(), self.bridge)
        self.endpoint = path.read_text().splitlines()[-1].strip()

    def wait_until(self, is_there, process):
        end_s = CLOCK.now_s() + START_S
        while not is_there():
            assert process.poll() is None, self.read_logs()
            assert CLOCK.now_s() < end_s, self.read_logs()
            CLOCK.sleep(0.1)

    def is_listening(self):
        host, port = self.address.split(":")
        with contextlib.suppress(OSError), socket.create_connection((host, int(port)), 1.0):
            return True
        return False

    def read_logs(self):
        return "\n".join(each.read_text()[-2000:] for each in self.folder.glob("*.log"))


def end(process):
    process.kill()
    process.wait()


@pytest.fixture(scope="module")
def systems(pytestconfig, tmp_path_factory):
    started = Systems(pytestconfig.option.lerobot_python, tmp_path_factory.mktemp("lerobot"))
    arrays = {"state": SHOWN["joint_state"], "front": SHOWN["camera_rgb"], "near": NEAR}
    shown = json.dumps({name: each.tolist() for name, each in arrays.items()})
    made = started.command(HERE / "make_act.py", started.folder / "act")
    done = subprocess.run(made, input=shown, capture_output=True, text=True, check=False, env=ENVIRONMENT)
    assert done.returncode == 0, done.stderr[-2000:]
    started.rows = np.array(json.loads(done.stdout.splitlines()[-1]))
    with contextlib.ExitStack() as stack:
        started.start_server()
        stack.callback(lambda: end(started.server))
        started.start_bridge()
        stack.callback(lambda: end(started.bridge))
        yield started


@contextlib.contextmanager
def open_client(endpoint, **heartbeat):
    client = PolicyClient(endpoint, 60.0, STREAMS, **heartbeat)
    try:
        yield client
    finally:
        client.close()


def ask(client, sequence=0, shown=SHOWN):
    start = None if sequence else wire.Start("s", "put it away", {}, 7)
    client.ask(wire.Infer(session="s", sequence=sequence, rows_done=0, time_s=0.0, observations=shown), start)
    while (chunk := client.poll()) is None:
        client.wait(1.0)
    return chunk


def watch(client):
    """As the loop of a session does between two requests."""
    for _ in range(1000):
        client.watch()
        CLOCK.sleep(0.01)


def test_what_a_policy_of_lerobot_answers_comes_through_the_bridge_and_no_pickle_with_it(systems):
    unpickled = []  # classes that this process looked up; a hook stays, so that no import of this file adds it
    sys.addaudithook(lambda event, found: unpickled.append(found) if event == "pickle.find_class" else None)
    assert ask_policy(systems.endpoint) is None, "it says nothing of itself"
    with open_client(systems.endpoint) as client:
        for sequence in range(3):
            chunk = ask(client, sequence)
            assert (chunk.sequence, chunk.rows.shape, chunk.done) == (sequence, (12, 8), False)
            assert chunk.rows == pytest.approx(systems.rows, abs=1e-6)
            assert 1e-5 < np.abs(chunk.rows - NEAR).max() < 1e-2, "they rest on what was shown"
    assert unpickled == []
    pickle.loads(pickle.dumps(np.float64))
    assert unpickled, "the hook hears of it"


def test_a_policy_of_lerobot_carries_out_a_session(systems, tmp_path):
    skill, graph = tmp_path / "skills" / "stay" / "SKILL.md", tmp_path / "rest.yaml"
    skill.parent.mkdir(parents=True)
    front = SKILL | {"policy": SKILL["policy"] | {"endpoint": systems.endpoint}}
    skill.write_text(f"---\n{yaml.safe_dump(front)}---\n# stay\n")
    graph.write_text(yaml.safe_dump(GRAPH))
    workspace = Workspace.create(tmp_path / "w", Library.open(tmp_path))
    with open_bench(workspace, CLOCK, memory_use=MemoryUse.NONE) as agent:
        (session,) = agent.mission.run(graph, seed=1).sessions
    assert (session.ended, session.verdict) == ("completed", "success"), session
    assert session.ticks == 26, "half a second, and one period to brake"
    assert len(read_exchanges(workspace.evidence_of(session.id))) == 3, "twelve rows each"


def test_an_observation_of_another_shape_is_refused_in_words(systems):
    few = SHOWN | {"joint_state": np.zeros(6)}
    with (
        open_client(systems.endpoint) as client,
        pytest.raises(ExecutionError, match=r"POLICY_FAILED: .*the shapes.*\(6,\)"),
    ):
        ask(client, shown=few)


def test_a_server_that_is_killed_is_named_within_the_heartbeat_and_served_again_once_it_is_back(systems):
    with open_client(systems.endpoint, heartbeat_s=HEARTBEAT_S, inference_s=30.0) as client:
        ask(client)
        end(systems.server)
        began_s = CLOCK.now_s()
        with pytest.raises(ExecutionError, match=f"{systems.address} is gone") as error:
            watch(client)
    assert error.value.code == "POLICY_LOST"
    assert CLOCK.now_s() - began_s < 2 * HEARTBEAT_S
    with pytest.raises(ExecutionError, match=f"{systems.address} is gone") as error:
        ask_policy(systems.endpoint)
    assert error.value.code == "POLICY_UNREACHABLE"
    systems.start_server()
    with open_client(systems.endpoint) as client:
        assert ask(client).rows == pytest.approx(systems.rows, abs=1e-6)
