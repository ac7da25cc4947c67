"""`kits/ros2_goals` beside ROS 2 itself: goals that rclpy's own action client calls, on physics, to their verdicts.

Needs the extra `mcp` in this Python, and ROS 2 with the built messages in build/ros2.
"""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from functools import partial
from itertools import count
from pathlib import Path

import pytest
import yaml

from phyagentos.agent.tools.proposals import Proposals
from phyagentos.clock import SystemClock
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.estop import is_latched, read_latch
from phyagentos.protocol.sessions.stop_signals import take_signals
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace
from tests.following import wait_until

pytestmark = [pytest.mark.extras, pytest.mark.journey]
ROOT = Path(__file__).resolve().parents[2]
MESSAGES = ROOT / "build" / "ros2" / "messages" / "lib"
PAOS = str(Path(sys.executable).with_name("paos"))
LIMIT_S, CLOCK = 180.0, SystemClock()
DOMAINS = count(os.getpid())  # one for each test
GREEN = """
goal: put_green
objective: Put the green cube into its tray.
scene: tabletop/cubes_and_trays
targets: {arm: panda}
defaults: {max_replans: 1}
budget: {sessions: 4, sim_time_s: 120}
sessions:
  green:
    skill: pick_and_place
    target: arm
    with: {object: green_cube, destination: green_tray}
    accept: ["inside(green_cube, green_tray)"]
accept: ["inside(green_cube, green_tray)"]
"""
POLICY = {
    "skills": ["close_hinged"],
    "targets": ["panda"],
    "budget": {"goals_a_day": 5, "sessions": 4, "sim_time_s": 120},
}


class Lines:
    """A process that writes a JSON object a line, and takes some."""

    def __init__(self, command, environment, **pipes):
        self.process = subprocess.Popen(
            command, env=environment, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **pipes
        )
        self._come, self._held = queue.SimpleQueue(), []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            self._come.put(json.loads(line))

    def say(self, **request):
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()

    def wait(self, event, limit_s=LIMIT_S, is_so=lambda _: True, **facts):
        """The first event that is so; those before it are kept for later."""
        deadline_s, at = CLOCK.now_s() + limit_s, 0
        while True:
            while at < len(self._held):
                found = self._held[at]
                if found["event"] == event and facts.items() <= found.items() and is_so(found):
                    del self._held[at]
                    return found
                at += 1
            left_s = deadline_s - CLOCK.now_s()
            assert left_s > 0, f"no {event} {facts} within {limit_s:g} s; came: {self._held}"
            with contextlib.suppress(queue.Empty):
                self._held.append(self._come.get(timeout=left_s))

    def wait_for_state(self, name, state):
        """Feedback of a goal's session in this state, now or before."""
        found = self.wait("feedback", is_so=lambda each: (each["name"], each["feedback"]["state"]) == (name, state))
        self._held.insert(0, found)

    def feedback(self, name):
        """What came for a goal so far."""
        return [each["feedback"] for each in self._held if each["event"] == "feedback" and each["name"] == name]

    def end(self):
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()


@pytest.fixture
def ros(pytestconfig):
    """The Python with ROS 2, and its environment: a domain of its own, on this machine alone."""
    pytest.importorskip("mcp", reason="needs the extra `mcp`: make test-extras")
    python = pytestconfig.option.ros2_python
    if python is None or not MESSAGES.is_dir():
        pytest.skip("needs ROS 2 and the built messages: make test-extras")
    found = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    packages = (str(MESSAGES / "python3.11" / "site-packages"), str(ROOT / "kits" / "ros2_goals"))
    return python, found | {
        "PYTHONPATH": os.pathsep.join(packages),
        "LD_LIBRARY_PATH": str(MESSAGES),
        "ROS_DOMAIN_ID": str(next(DOMAINS) % 101),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PHYAGENTOS_MEMORY": "none",
    }


@pytest.fixture
def workspace(tmp_path):
    return Workspace.create(tmp_path / "w", Library.open(ROOT))


@pytest.fixture
def caller(ros):
    with calling(ros) as client:
        yield client


@contextlib.contextmanager
def calling(ros):
    python, environment = ros
    client = Lines([python, str(Path(__file__).with_name("call_goals.py"))], environment)
    client.wait("ready")
    yield client
    client.end()


@contextlib.contextmanager
def serving(ros, workspace, *options):
    python, environment = ros
    command = [PAOS, "ros2", "serve", "-w", str(workspace.root), "--python", python, *options]
    process = subprocess.Popen(command, env=environment, cwd=ROOT)
    try:
        yield process
    finally:
        process.terminate()
        assert process.wait(60.0) in {0, -9}


@pytest.fixture
def served(ros, workspace):
    with serving(ros, workspace, "--level", "propose", "--permit", "close_door", "--permit", "tidy_table"):
        yield


@contextlib.contextmanager
def running(*words):
    """A command of the framework that goes on."""
    process = subprocess.Popen([PAOS, *map(str, words)], cwd=ROOT)
    try:
        yield
    finally:
        process.terminate()
        process.wait(60.0)


def paos(*words):
    subprocess.run([PAOS, *map(str, words)], cwd=ROOT, check=True, timeout=LIMIT_S, capture_output=True)


def wait_for_proposals(workspace):
    """What waits for a decision, once something does."""
    wait_until(lambda: Proposals(workspace.proposals).list_waiting(), "a proposal")
    return Proposals(workspace.proposals).list_waiting()


def session_states(workspace):
    return {id.split(".", 1)[1]: str(each.state) for id, each in read_ledger(workspace.root).sessions.items()}


def test_a_goal_succeeds_by_its_verdict_and_its_feedback_is_the_journal(served, caller, workspace):
    caller.say(do="send", name="a", graph="close_door", seed=7)
    caller.wait("accepted", name="a")
    done = caller.wait("result", name="a")
    assert done["status"] == "SUCCEEDED"
    result = done["result"]
    assert (result["verdict"], result["failed_criteria"], result["causes"]) == ("success", [], [])
    assert [Path(each).name for each in result["evidence"]] == [f"{result['goal']}.shut"]
    shown = [(each["node"], each["state"], each["verdict"]) for each in caller.feedback("a")]
    states = (
        "pending",
        "claimed",
        "preflight",
        "running",
        "halting",
        "awaiting_verification",
        "verifying",
        "succeeded",
    )
    assert [state for node, state, _ in shown if node == "shut" and state not in {"ready", "done"}] == [*states]
    assert ("shut", "succeeded", "success") in shown
    assert shown[-1] == ("", "verdict", "success")
    assert read_ledger(workspace.root).goals[result["goal"]].verdict == "success"


def test_a_goal_that_a_fault_spoils_is_aborted_with_what_does_not_hold(ros, caller, workspace, tmp_path):
    policy = tmp_path / "policy.yaml"
    policy.write_text(yaml.safe_dump(POLICY | {"skills": ["pick_and_place"]}), encoding="utf-8")
    runtime = ["watch", "--workspace", workspace.root, "--faults", "faults/removed.yaml", "--no-pictures"]
    with running(*runtime), serving(ros, workspace, "--level", "submit", "--policy", str(policy)):
        caller.say(do="send", name="a", graph=GREEN, seed=7)
        done = caller.wait("result", name="a")
    assert done["status"] == "ABORTED"
    result = done["result"]
    assert result["verdict"] == "failure", result
    assert result["failed_criteria"][0].startswith("inside(green_cube, green_tray): "), result
    assert any(each.startswith(f"{result['goal']}.green") for each in result["causes"]), result


def test_what_the_policy_does_not_permit_is_aborted_with_its_reasons(ros, caller, workspace, tmp_path):
    policy = tmp_path / "policy.yaml"
    policy.write_text(yaml.safe_dump(POLICY), encoding="utf-8")
    with serving(ros, workspace, "--level", "submit", "--policy", str(policy)):
        caller.say(do="send", name="a", graph=GREEN)
        done = caller.wait("result", name="a")
    assert (done["status"], done["result"]["verdict"]) == ("ABORTED", "")
    assert "green.skill: NOT_PERMITTED: found pick_and_place; expected close_hinged" in done["result"]["reason"]
    assert not read_ledger(workspace.root).sessions


def test_a_cancel_in_mid_motion_halts_within_two_seconds(served, caller, workspace):
    caller.say(do="send", name="a", graph="tidy_table", seed=7)
    caller.wait_for_state("a", "running")
    CLOCK.sleep(1.0)
    asked_s = CLOCK.now_s()
    caller.say(do="cancel", name="a")
    assert caller.wait("cancelling", name="a")["n"] == 1
    caller.wait_for_state("a", "cancelled")
    took_s = CLOCK.now_s() - asked_s
    done = caller.wait("result", name="a")
    sys.stdout.write(f"cancelled {took_s:.2f} s after the request, result at {CLOCK.now_s() - asked_s:.2f} s\n")
    assert (done["status"], done["result"]["verdict"]) == ("CANCELED", "cancelled")
    assert set(session_states(workspace).values()) <= {"cancelled", "succeeded"}
    assert "cancelled" in session_states(workspace).values()
    assert took_s < 2.0


def names(why, diagnostics):
    return why in diagnostics["values"]["last rejection"]


def test_what_cannot_be_proposed_is_rejected_and_diagnostics_say_why(served, caller):
    for name, why, goal in (
        ("unknown", "UNKNOWN_NAME goal_graphs/close_doo.yaml", {"graph": "close_doo"}),
        ("form", "found 'speed'; expected KEY=VALUE", {"graph": "close_door", "parameters": ["speed"]}),
        ("parameter", "UNKNOWN_NAME --set speed", {"graph": "close_door", "parameters": ["speed=1"]}),
        ("neither", "found none of them; expected one", {}),
        ("both", "found both of them; expected one", {"graph": "close_door", "words": "close the door"}),
        ("seed", "seed: found -1", {"graph": "close_door", "seed": -1}),
    ):
        caller.say(do="send", name=name, **goal)
        caller.wait("rejected", name=name)
        caller.wait("diagnostics", is_so=partial(names, why))


def test_goals_at_once_run_one_after_the_other_and_one_that_waits_is_cancelled_at_once(ros, caller, workspace):
    with serving(ros, workspace, "--level", "propose", "--permit", "close_door", "--waiting", "2"):
        for name in ("first", "second", "third"):
            caller.say(do="send", name=name, graph="close_door", seed=7)
            caller.wait("accepted", name=name)
        caller.say(do="send", name="fourth", graph="close_door", seed=7)
        caller.wait("rejected", name="fourth")
        caller.say(do="cancel", name="third")
        third = caller.wait("result", name="third", limit_s=5.0)
        assert (third["status"], third["result"]["goal"]) == ("CANCELED", "")
        first, second = (caller.wait("result", name=name) for name in ("first", "second"))
    assert [first["status"], second["status"]] == ["SUCCEEDED"] * 2
    assert caller.feedback("first")[-1]["at_s"] <= caller.feedback("second")[0]["at_s"]
    assert {each.verdict for each in read_ledger(workspace.root).goals.values()} == {"success"}


def test_a_server_that_is_killed_leaves_no_motion_and_the_next_one_serves(ros, caller, workspace):
    options = ("--level", "propose", "--permit", "close_door", "--permit", "tidy_table")
    with serving(ros, workspace, *options) as process:
        caller.say(do="send", name="a", graph="tidy_table", seed=7)
        caller.wait_for_state("a", "running")
        process.kill()
    wait_until(
        lambda: all(each.is_cancelled for each in read_ledger(workspace.root).goals.values()), "its cancellation"
    )
    wait_until(lambda: not is_held(workspace.root / RUNTIME_LOCK), "the end of the runtime")
    assert "running" not in session_states(workspace).values()
    with serving(ros, workspace, *options), calling(ros) as another:  # the first one believes in the dead for seconds
        another.say(do="send", name="b", graph="close_door", seed=7)
        assert another.wait("result", name="b")["status"] == "SUCCEEDED"


def test_a_server_that_is_ended_cancels_its_goal_and_answers_the_caller(ros, caller, workspace):
    with serving(ros, workspace, "--level", "propose", "--permit", "tidy_table") as process:
        caller.say(do="send", name="a", graph="tidy_table", seed=7)
        caller.wait_for_state("a", "running")
        process.terminate()
        done = caller.wait("result", name="a")
    assert (done["status"], done["result"]["verdict"]) == ("ABORTED", "cancelled")
    assert "running" not in session_states(workspace).values()


def test_a_managed_server_takes_goals_while_it_is_active_and_cancels_them_when_it_rests(ros, caller, workspace):
    options = ("--level", "propose", "--permit", "close_door", "--permit", "tidy_table", "--managed")
    with serving(ros, workspace, *options):
        caller.wait("diagnostics", message="not active")
        caller.say(do="send", name="early", graph="close_door", seed=7)
        caller.wait("rejected", name="early")
        caller.wait("diagnostics", is_so=partial(names, "ros2 lifecycle set /phyagentos activate"))
        for transition in ("CONFIGURE", "ACTIVATE"):
            caller.say(do="change", transition=transition)
            caller.wait("changed", transition=transition, success=True)
        caller.say(do="send", name="a", graph="tidy_table", seed=7)
        caller.wait_for_state("a", "running")
        caller.say(do="change", transition="DEACTIVATE")
        caller.wait("changed", transition="DEACTIVATE", success=True)
        done = caller.wait("result", name="a")
        assert (done["status"], done["result"]["verdict"]) == ("ABORTED", "cancelled")
        caller.say(do="send", name="late", graph="close_door", seed=7)
        caller.wait("rejected", name="late")
    assert "running" not in session_states(workspace).values()


def kill_servants(workspace):
    """The tools and the follower of a node, whose command lines name the workspace."""
    for name in ("mcp", "follow"):
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                words = path.read_text().split("\0")
                if name in words and str(workspace.root) in words and PAOS in words:
                    os.kill(int(path.parent.name), signal.SIGKILL)


def test_a_goal_ends_by_its_verdict_when_what_the_node_relies_on_is_killed(served, caller, workspace):
    caller.say(do="send", name="a", graph="close_door", seed=7)
    caller.wait_for_state("a", "claimed")
    kill_servants(workspace)
    done = caller.wait("result", name="a")
    assert (done["status"], done["result"]["verdict"]) == ("SUCCEEDED", "success")
    kill_servants(workspace)
    caller.say(do="trigger", name="stop")
    assert caller.wait("stop")["success"]
    assert is_latched(workspace.signals.parent)


def test_a_folder_that_is_no_workspace_is_refused_at_the_start(ros, tmp_path):
    python, environment = ros
    command = [python, "-m", "ros2_goals", tmp_path / "nowhere", "--paos", PAOS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 1
    assert "NOT_A_WORKSPACE: found no such folder" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_stop_service_latches_and_pause_rests(served, caller, workspace):
    caller.say(do="trigger", name="pause")
    assert caller.wait("pause")["success"]
    assert [(each.kind, each.session) for each in take_signals(workspace.signals)] == [("pause", "*")]
    caller.say(do="trigger", name="stop")
    assert caller.wait("stop")["success"]
    assert read_latch(workspace.signals.parent).reason == "a ROS 2 service call"
    caller.wait("diagnostics", message="emergency stop is latched", level=2)


def test_a_person_decides_on_what_is_not_permitted(ros, caller, workspace):
    with serving(ros, workspace, "--level", "propose"):
        for name in ("denied", "dropped", "approved"):
            caller.say(do="send", name=name, graph="close_door", seed=7)
            (proposal,) = wait_for_proposals(workspace)
            if name == "dropped":
                caller.say(do="cancel", name=name)
            elif name == "denied":
                paos("deny", proposal, "-w", workspace.root, "--reason", "guests are here")
            else:
                paos("approve", proposal, "-w", workspace.root, "--yes")
            done = caller.wait("result", name=name)
            wanted = {"denied": "ABORTED", "dropped": "CANCELED", "approved": "SUCCEEDED"}
            assert done["status"] == wanted[name], done
            assert name != "denied" or done["result"]["reason"] == "denied: guests are here"


def test_a_request_in_words_runs_as_the_graph_that_it_names(ros, caller, workspace, tmp_path):
    with serving(ros, workspace, "--level", "propose"):
        caller.say(do="send", name="a", words="close the door", scene="tabletop/door_and_lid", seed=7)
        (proposal,) = wait_for_proposals(workspace)
        assert proposal.startswith("close_the_door-")
        paos("approve", proposal, "-w", workspace.root, "--yes")
        assert caller.wait("result", name="a")["status"] == "SUCCEEDED"
        caller.say(do="send", name="b", words="frobnicate the door", scene="tabletop/door_and_lid")
        done = caller.wait("result", name="b")
        assert done["status"] == "ABORTED"
        assert "frobnicate" in done["result"]["reason"]


def test_a_server_of_the_level_read_takes_no_goal(ros, caller, workspace):
    with serving(ros, workspace):
        caller.say(do="send", name="a", graph="close_door")
        caller.wait("rejected", name="a")


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        (["close_doo", "close_door"], "SUCCESS"),
        (["--halt", "tidy_table"], "halted cancelled\nINVALID"),
    ],
    ids=["to its end", "halted"],
)
def test_a_tree_of_others_has_verified_goals_as_its_leaves(ros, served, words, printed):
    python, environment = ros
    tree = [python, Path(__file__).with_name("tree_of_goals.py"), *words]
    done = subprocess.run(tree, env=environment, capture_output=True, text=True, timeout=2 * LIMIT_S, check=False)
    assert done.stdout.strip() == printed, done.stderr
