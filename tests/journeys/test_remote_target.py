"""A session on a target that another workspace serves over WebSocket: the same protocol, so the same bits."""

import subprocess
import sys

import pytest

from phyagentos.operations.preflight import check
from phyagentos.operations.rerun import find_differences
from phyagentos.operations.why import why
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.targets.handshake import make_key
from tests.served_kit import lead_elsewhere

from .conftest import open_plane

pytestmark = pytest.mark.journey


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """The arm of another workspace at a port of this machine: its endpoint, and the key that admits."""
    root = tmp_path_factory.mktemp("served") / "there"
    workspace, key = Workspace.create(root, Library.open()), make_key().hex()
    command = [sys.executable, "-m", "phyagentos.assembly.processes", "world", "--workspace", str(workspace.root)]
    command += ["--target", "panda", "--socket", "ws://127.0.0.1:0"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        process.stdin.write(f"panda {key}\n")
        process.stdin.flush()
        yield process.stdout.readline().strip(), key, workspace
        process.stdin.close()  # it ends with its parent
        assert process.wait(30) == 0


def test_a_session_over_websocket_has_the_bits_of_one_over_a_socket_whatever_ran_before(plane, tmp_path, served):
    endpoint, key, there = served
    near = plane
    with open_plane(tmp_path / "far", prepare=lambda made: lead_elsewhere(made, "panda", endpoint, key)) as far:
        reports = [plane.run("ws-3", seed=3) for plane in (near, far)]

    assert [report.verdict for report in reports] == ["success", "success"]
    assert reports[0].criteria == reports[1].criteria
    (session,) = reports[1].sessions
    differences = find_differences(near.bundle(session.id), far.bundle(session.id))
    assert differences == ["execution.json: differs"]  # it says which driver moved
    told = ["\n".join(why(plane.workspace.root, session.id).explanation) for plane in (near, far)]
    assert "moved by    driver mujoco" in told[0]
    assert "moved by    driver remote/mujoco" in told[1]
    lines = [
        (plane / "logs" / "receive-panda.jsonl").read_text().splitlines()
        for plane in (near.workspace.root, far.workspace.root, there.root)
    ]
    commands = [sum('"Command"' in line and session.id in line for line in each) for each in lines]
    assert commands[0] == commands[1] == commands[2] > 100


def test_preflight_reaches_a_target_that_is_served_elsewhere_with_the_key_of_its_workspace(tmp_path, served):
    endpoint, key, _ = served
    workspace = Workspace.create(tmp_path / "here", Library.open())
    lead_elsewhere(workspace, "panda", endpoint, key)
    assert check("tidy_table", workspace.root, seed=3).refused == ()
