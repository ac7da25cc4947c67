"""Actions, services and topics of ROS as leaves, before servers that misbehave."""

import ast
import itertools
import os
import queue
import subprocess
import threading
import time
from pathlib import Path

import pytest

from phyagentos.operations.lint import lint_file
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.sessions.session import Ended, Scene
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.execution.call_check import iter_call_problems
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import greet, make_key, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.websocket import connect_websocket
from phyagentos.testing import SkillStand, make_contract
from tests.extras.ros2.cell import KITS, ROOT, SCENE, Process, write_project
from tests.extras.ros2.conftest import DOMAINS

pytestmark = pytest.mark.extras

HERE, COUNTER = Path(__file__).parent, ROOT / "benchmarks" / "library"
NUMBERS = itertools.count(1)
REJECTED, ABORTED, SLOW, STUBBORN, DEAD = -1, 100, 200, 300, 400


class Rig:
    """The servers, the kit before them, and a stand for skills on it."""

    def __init__(self, folder, python):
        self.domain = {"ROS_DOMAIN_ID": str(next(DOMAINS) % 101)}
        self.servers = Process([python, HERE / "misbehaving.py"], folder / "servers.log", **self.domain)
        self._lines = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()
        assert self.hear() == "ready"
        paths = os.pathsep.join((KITS, str(ROOT / "examples" / "projects" / "05_any_body")))
        self.body = Process([python, HERE / "called.py"], folder / "body.log", PYTHONPATH=paths, **self.domain)
        key = make_key()
        self.body.tell(key.hex())
        endpoint = self._read(self.body)
        assert endpoint.startswith("ws://"), (endpoint, (folder / "body.log").read_text()[-2000:])
        profile = read_target(COUNTER / "robots" / "counter" / "target.yaml")
        limits = read_safety(COUNTER / "protocol" / "safety.yaml").targets["counter"]
        greet(channel := connect_websocket(endpoint), mint(key))
        target = ServedTarget(RemoteDriver(profile, channel, key), ReceiveLog(None))
        library = Library((folder, COUNTER, find_shipped_root()))
        self.stand = SkillStand(folder, target=target, library=library, robot=(profile, limits))
        self.run(count(1, ", accept_within_s: 30.0"))  # until each has found the other
        assert [self.hear(), self.hear()] == [{"began": 1}, {"ended": 1}]

    @staticmethod
    def _read(process):
        return process.process.stdout.readline().strip()

    def run(self, root, header=""):
        """A session by a tree of this root: its execution and the message of its call."""
        self.stand.add_tree(f"tree: called\ndescription: Calls.\n{header}root: {root}\n")
        scene = Scene(name="counter", seed=0, episode="e")
        session = make_contract(id=f"g.n{next(NUMBERS)}", skill="called", target="counter", scene=scene)
        return self.stand.run(session, "called")

    def hear(self):
        """The next line that the servers say."""
        return self._lines.get(timeout=60.0)

    def _listen(self):
        for line in self.servers.process.stdout:
            self._lines.put(ast.literal_eval(line) if line.startswith("{") else line.strip())

    def find_problems(self, root):
        self.stand.add_tree(f"tree: called\ndescription: Calls.\nroot: {root}\n")
        live = self.stand.handle.describe().procedures
        return [str(each) for each in iter_call_problems("called", self.stand.library, live, "counter")]

    def close(self):
        self.stand.target.close()
        self.body.close()
        self.servers.kill()
        self.servers.close()


@pytest.fixture(scope="module")
def python(find_python):
    return find_python()


@pytest.fixture(scope="module")
def shared(tmp_path_factory, python):
    made = Rig(tmp_path_factory.mktemp("rig"), python)
    yield made
    made.close()


@pytest.fixture
def rig(tmp_path, python):
    """One of its own, for what leaves servers or sessions stopped."""
    made = Rig(tmp_path, python)
    yield made
    made.close()


def count(order, more=""):
    return f"{{call: {{action: count, type: test_msgs/action/Fibonacci, goal: {{order: {order}}}{more}}}}}"


def test_an_action_gives_feedback_and_a_result(shared):
    more = ", feedback: {sequence: '${way}'}, result: {sequence: '${numbers}'}"
    execution = shared.run(count(4, more), "outputs: {way: {type: point}, numbers: {type: point}}\n")

    assert execution.ended is Ended.COMPLETED, execution.message
    assert execution.outputs == {"way": [0, 1, 1, 2, 3, 5], "numbers": [0, 1, 1, 2, 3]}
    assert [shared.hear(), shared.hear()] == [{"began": 4}, {"ended": 4}]


@pytest.mark.parametrize(
    ("order", "says"), [(REJECTED, "count was rejected"), (ABORTED, "count was aborted")], ids=["rejected", "aborted"]
)
def test_a_goal_that_its_server_does_not_carry_out_is_a_failure(shared, order, says):
    execution = shared.run(count(order))

    assert (execution.code, execution.is_final) == ("CALL_FAILED", False)
    assert says in execution.message
    if order == ABORTED:
        assert shared.hear() == {"began": ABORTED}


def test_a_goal_that_is_accepted_too_late_is_cancelled_with_its_acceptance(shared):
    execution = shared.run(count(SLOW, ", accept_within_s: 0.3"))

    assert execution.code == "TIMED_OUT"
    assert "not accepted within 0.3 s, and cancelled; count was cancelled" in execution.message
    assert [shared.hear(), shared.hear()] == [{"began": SLOW}, {"cancelled": SLOW}]


@pytest.mark.parametrize("order", [60, SLOW], ids=["accepted", "before it is accepted"])
def test_a_halt_cancels_the_goal(shared, order):
    execution = shared.run(f"{{timeout: {{seconds: 0.3, child: {count(order)}}}}}")

    assert execution.code == "TIMED_OUT"
    assert [shared.hear(), shared.hear()] == [{"began": order}, {"cancelled": order}]


def test_a_server_that_refuses_the_cancel_stops_the_session_and_keeps_out_the_next(rig):
    halted = f"{{timeout: {{seconds: 0.3, child: {count(STUBBORN, ', cancel_within_s: 0.4')}}}}}"
    execution = rig.run(f"{{fallback: {{children: [{halted}, {{wait: {{seconds: 4.0}}}}]}}}}")

    assert (execution.ended, execution.code) == (Ended.SAFETY_STOP, "PROTECTIVE_STOP"), execution.message
    assert "BUSY" in rig.run("{wait: {seconds: 0.1}}").message
    assert [rig.hear(), rig.hear()] == [{"began": STUBBORN}, {"ended": STUBBORN}]
    later = (rig.run("{wait: {seconds: 0.1}}").ended for _ in range(20))  # the result is still on its way
    assert Ended.COMPLETED in later


def test_a_server_that_dies_does_not_hold_the_session(rig):
    began_s = time.monotonic()  # noqa: TID251
    execution = rig.run(f"{{timeout: {{seconds: 3.0, child: {count(DEAD)}}}}}")

    assert execution.code in ("CALL_FAILED", "TIMED_OUT"), "as soon as the graph shows it, or the tree's limit"
    assert time.monotonic() - began_s < 30.0  # noqa: TID251


def test_without_a_server_nothing_is_sent(shared):
    execution = shared.run("{call: {action: nowhere, goal: {order: 1}, accept_within_s: 0.3}}")

    assert execution.code == "TIMED_OUT"
    assert "nowhere was not accepted within 0.3 s, and cancelled; nowhere was lost: there is no" in execution.message


def test_fields_of_nested_messages_are_filled_and_read(shared):
    goal = "nested_field: {int32_value: 4, float64_value: 2}, nested_different_pkg: {sec: 9}"
    result = "nested_field: {int32_value: '${more}', float64_value: '${never}'}"
    outputs = "outputs: {more: {type: integer}, never: {type: number}}\n"
    execution = shared.run(f"{{call: {{action: nested, goal: {{{goal}}}, result: {{{result}}}}}}}", outputs)

    assert execution.outputs == {"more": 5}, "what is not finite is left out"
    assert shared.hear() == {"nested": [4, 2.0, 9]}


@pytest.mark.parametrize(
    ("root", "code", "says"),
    [
        ("{call: {service: /cell/door, goal: {data: true}}}", "", ""),
        ("{call: {service: /cell/door, goal: {data: false}}}", "CALL_FAILED", "door was aborted: it is locked"),
        ("{call: {service: mute, accept_within_s: 0.3}}", "TIMED_OUT", "mute was not accepted within 0.3 s, and canc"),
        ("{call: {topic: deaf, accept_within_s: 0.3}}", "TIMED_OUT", "deaf was not accepted within 0.3 s, and canc"),
    ],
)
def test_services_and_topics_end_as_their_servers_say(shared, root, code, says):
    execution = shared.run(root)

    assert execution.code == code
    assert says in execution.message


def test_a_topic_takes_a_place_and_gives_its_next_message(shared):
    pose = "{call: {topic: goal_pose, goal: {pose: mark}}}"
    whole = "{call: {topic: goal_pose, goal: {pose: {orientation: {w: 1.0}}, header: {frame_id: map}}}}"
    tick = "{call: {topic: tick, result: {data: '${tick}'}}}"
    children = f"[{pose.replace('pose: mark', 'pose.position: mark')}, {whole}, {tick}]"
    execution = shared.run(f"{{sequence: {{children: {children}}}}}", "outputs: {tick: {type: integer}}\n")

    assert execution.outputs == {"tick": 7}, execution.message
    assert [shared.hear(), shared.hear()] == [{"pose": ["", 0.0, 1.0]}, {"pose": ["map", 0.0, 1.0]}]


@pytest.mark.parametrize(
    ("root", "says"),
    [
        ("{call: {action: count, goal: {order: 4}}}", ""),
        ("{call: {action: count, goal: {ordre: 4}}}", "UNKNOWN_NAME (field of goal): found 'ordre'; expected order"),
        ("{call: {action: count, goal: {order: four}}}", "INVALID_VALUE: found 'four'; expected type integer"),
        (
            "{call: {action: cuont, goal: {order: 4}}}",
            "UNKNOWN_NAME (procedure): found 'cuont', which counter does not",
        ),
        ("{call: {service: count}}", "INVALID_VALUE: found service 'count'; expected it as action"),
        (
            "{call: {action: count, type: a/action/B}}",
            "TARGET_MISMATCH: found 'a/action/B'; expected test_msgs/action/",
        ),
        ("{call: {action: count, result: {sequenc: '${a}'}}}", "UNKNOWN_NAME (field of result): found 'sequenc'"),
    ],
)
def test_a_call_is_checked_against_the_installed_types(shared, root, says):
    assert [says in each for each in shared.find_problems(root)] == ([True] if says else [])


def test_a_robot_offers_what_its_file_names(make_cell):
    cell = make_cell(ros2={"procedures": {"stop": {"type": "std_srvs/srv/Trigger"}}})
    target = cell.reach()
    (stop,) = target.exchange(wire.Describe()).procedures
    target.exchange(wire.LoadScene(SCENE, 1, "e"))
    target.exchange(wire.Begin("s", 1))
    progress = target.exchange(wire.Call("s", 1, 1, "stop", {}, 1.0))
    for _ in range(100):
        if progress.state.has_ended:
            break
        target.exchange(wire.Settle("s", 1, 0.02))
        progress = target.exchange(wire.Follow("s", 1, 1))

    assert (stop.kind, stop.type, stop.result) == (
        "service",
        "std_srvs/srv/Trigger",
        {"success": "boolean", "message": "string"},
    )
    assert progress.state == "succeeded", progress
    assert cell.robot.ask("truth")["stops"] == 1


def test_lint_knows_the_types_that_were_written_down(python, tmp_path):
    write_project(tmp_path, cameras=(), procedures={"count": {"type": "test_msgs/action/Fibonacci"}})
    command = [python, "-m", "ros2_body.interfaces", "robots/panda/target.yaml"]
    done = subprocess.run(command, cwd=tmp_path, env={"PYTHONPATH": KITS}, text=True, capture_output=True, check=True)
    (tmp_path / "trees" / "mine.yaml").write_text(f"tree: mine\ndescription: D.\nroot: {count(4)}\n")

    assert done.stdout == "wrote robots/panda/procedures.json\n"
    assert not lint_file(tmp_path / "trees" / "mine.yaml")
    (tmp_path / "trees" / "mine.yaml").write_text(f"tree: mine\ndescription: D.\nroot: {count('four')}\n")
    (problem,) = lint_file(tmp_path / "trees" / "mine.yaml")
    assert "INVALID_VALUE: found 'four'; expected type integer" in str(problem)


def test_a_type_that_is_not_installed_is_named_at_the_start(make_cell):
    cell = make_cell(ros2={"procedures": {"drive": {"type": "nav2_msgs/action/NavigateToPose"}}})

    says = cell.serve()
    assert "ros2.yaml: procedures.drive.type: found nav2_msgs/action/NavigateToPose is not installed" in says
    assert cell.bodies.pop().close() == 2
