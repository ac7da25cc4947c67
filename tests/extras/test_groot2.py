"""`paos tree serve` before a client of Groot2's protocol that is not ours, beside BehaviorTree.CPP's own publisher."""

import signal
import struct
import subprocess
import sys
import tarfile
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from phyagentos.operations.behaviour_trees import read_live_tree
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.trace import TraceEvent
from tests.following import wait_until

HOW = "needs pyzmq, btview and behaviortreepy: make test-extras"
zmq = pytest.importorskip("zmq", reason=HOW)
client = pytest.importorskip("btview.client", reason=HOW)
engine = pytest.importorskip("behaviortreepy", reason=HOW)
pytestmark = pytest.mark.extras

ARCHIVE = Path(__file__).parents[1] / "cli" / "stored" / "tidy_table_0_1_0.tar.xz"
PAOS = str(Path(sys.executable).with_name("paos"))
HEAD = struct.Struct("<BcI")


@pytest.fixture
def serve():
    """Starts `paos tree serve` at a free port; its port."""
    started = []

    def serve(workspace):
        command = [PAOS, "tree", "serve", "-w", workspace, "--port", "0"]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        address = started[-1].stdout.readline().strip()
        assert address.startswith("tcp://127.0.0.1:")
        return int(address.rsplit(":", 1)[1])

    yield serve
    for each in started:
        each.send_signal(signal.SIGINT)
        assert each.wait(20) == 0
        each.stdout.close()


@pytest.fixture
def stored(tmp_path):
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path / "tidy_table"


def ask(port, *parts):
    with zmq.Context() as context, context.socket(zmq.REQ) as socket:
        socket.linger, socket.rcvtimeo = 0, 10_000
        socket.connect(f"tcp://127.0.0.1:{port}")
        socket.send_multipart(parts)
        return socket.recv_multipart()


def find_states(shown, polled):
    """State of each node by its name; of several the last in the order of their numbers."""
    return {node.name: polled.statuses[uid].status.name for uid, node in sorted(shown.by_uid.items())}


def test_a_client_that_is_not_ours_reads_the_tree_and_its_states(stored, serve):
    groot = client.Groot2Client("127.0.0.1", serve(stored), timeout_ms=20_000)
    try:
        shown, polled = groot.fetch_tree(), groot.poll()
        names = [node.name for node in shown.by_uid.values()]
        assert {"pick_and_place", "plan_grasp", "close_gripper", "retreat"} <= set(names)
        assert set(polled.statuses) == set(shown.by_uid)
        assert shown.size == len(shown.by_uid), "a subtree stands once for each place that has it"
        states = find_states(shown, polled)
        assert (states["close_gripper"], states["retreat"]) == ("SUCCESS", "SUCCESS")
        assert groot.fetch_blackboard() == {}
    finally:
        groot.close()


def test_replies_are_those_of_the_publisher_of_behaviortree_cpp(stored, serve):
    xml = """<root BTCPP_format="4" main_tree_to_execute="Main"><BehaviorTree ID="Main"><Sequence name="root">
    <AlwaysSuccess name="a"/><SubTree ID="Sub" name="sub"/><Sleep name="s" msec="60000"/></Sequence></BehaviorTree>
    <BehaviorTree ID="Sub"><Inverter name="inv"><AlwaysFailure name="f"/></Inverter></BehaviorTree></root>"""
    factory = engine.BehaviorTreeFactory()
    factory.register_behavior_tree_from_text(xml)
    tree = factory.create_tree("Main")
    publisher, theirs = engine.Groot2Publisher(tree, 29667), 29667
    tree.tick_exactly_once()
    ours = serve(stored)
    for kind in (b"T", b"S", b"D"):
        request = HEAD.pack(2, kind, 0x01020304)
        their, our = ask(theirs, request), ask(ours, request)
        assert [len(each) for each in (our[0], our)] == [len(each) for each in (their[0], their)] == [22, 2]
        assert our[0][:6] == their[0][:6] == request
    assert len(ask(theirs, HEAD.pack(2, b"S", 1))[1]) == 3 * 6, "two bytes and one for each of six nodes"
    for request in (HEAD.pack(2, b"Z", 1), b"short"):
        assert ask(theirs, request)[0] == ask(ours, request)[0] == b"error"
    for number, kind in enumerate((b"I", b"U", b"r", b"t")):
        assert ask(ours, HEAD.pack(2, kind, number), b"{}")[0] == b"error", (
            "it takes no breakpoints and records nothing"
        )
    del publisher


def test_every_node_has_the_number_under_which_its_state_is_sent_and_a_subtree_each_place_its_own():
    live = read_live_tree("pick_and_place", Library.open())
    root = ET.fromstring(live.xml)
    numbered = {int(each.get("_uid")): each for each in root.iter() if each.get("_uid")}
    assert sorted(numbered) == list(range(1, len(live.paths) + 1))
    places = [each.get("_fullpath") for each in root.iter("BehaviorTree")]
    assert len(places) == len(set(places))
    assert {"", "pick", "place", "free_hand", "free_hand/place", "pick/free_hand"} <= set(places)

    path = "pick_and_place/pick/plan_grasp"
    codes = []
    for statuses in (("RUNNING",), ("RUNNING", "SUCCESS"), ("RUNNING", "INVALID"), ("RUNNING", "FAILURE", "INVALID")):
        live.follow(TraceEvent(tick=0, time_s=0.0, path=path, leaf="plan_grasp", status=each) for each in statuses)
        codes.append(dict(struct.iter_unpack("<HB", live.encode()))[live.paths.index(path) + 1])
    assert codes == [1, 2, 11, 13], "running, success, idle since it ran, idle since it failed"
    (number,) = (at for at, each in numbered.items() if each.tag == "plan_grasp" and live.paths[at - 1] == path)
    assert numbered[number].get("name") == "plan_grasp"


@pytest.mark.journey
def test_the_tree_of_a_running_session_is_followed_live(tmp_path, serve):
    workspace = tmp_path / "w"
    command = [PAOS, "run", "close_door", "--seed", "3", "-w", workspace]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_until((workspace / "TARGETS.md").exists, "a workspace", 60.0)
    groot = client.Groot2Client("127.0.0.1", serve(workspace), timeout_ms=20_000)
    seen = set()

    def look():
        try:
            states = find_states(groot.fetch_tree(), groot.poll())
        except client.ProtocolError:
            return False
        seen.update(states.values())
        return running.poll() is not None

    try:
        wait_until(look, "the end of the goal", 300.0)
    finally:
        groot.close()
        running.kill()
        running.wait()
    assert running.returncode == 0
    assert {"RUNNING", "SUCCESS"} <= seen
