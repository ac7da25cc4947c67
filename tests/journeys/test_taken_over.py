"""A person takes an arm over in mid-session, on real physics: guarded, recorded, judged, and the goal goes on after."""

import threading
from queue import Queue

import msgspec
import numpy as np
import pytest

from phyagentos.cli.taking_over import BACK, Keyboard
from phyagentos.operations.stop import find_opening, take_over
from phyagentos.operations.why import why
from phyagentos.policies import PolicyDescriptor, serve_policy
from phyagentos.protocol.sessions.evidence import AFTER
from phyagentos.protocol.world.environment import Environment
from tests.following import wait_until
from tests.journeys.test_stopping import Running, count

pytestmark = pytest.mark.journey


class Watched(Keyboard):
    """Keeps where the tool was when the arm was taken over; `hurry_m` is added to each step."""

    begin_m, hurry_m = None, 0.0

    def infer(self, request):
        if self.begin_m is None:
            self.begin_m = np.array(request.observations["tool_pose"][:3])
        rows, is_over = super().infer(request)
        rows[:, 0] += self.hurry_m
        return rows, is_over


def serve(leader) -> str:
    addresses = Queue[str]()
    descriptor = PolicyDescriptor(policy="test", endpoint="tcp://127.0.0.1:0", observations={}, inference_s=1.0)
    threading.Thread(target=serve_policy, args=(leader, descriptor, addresses.put), daemon=True).start()
    return addresses.get()


def take(plane, name: str, leader: Watched) -> Running:
    """A goal whose arm is the leader's in the midst of its first session."""
    begun = count(plane, "Command")
    running = Running(plane, name)
    wait_until(lambda: count(plane, "Command") >= begun + 20)
    take_over(f"{name}.red", plane.workspace.root, leader=serve(leader), by="ada")
    wait_until(leader.is_taken.is_set)
    return running


def read_tool_m(plane, session: str, file: str) -> np.ndarray:
    world = msgspec.json.decode((plane.bundle(session) / file).read_bytes(), type=Environment)
    return np.array(world.targets["panda"].tcp.position_m)


def test_a_person_moves_the_tool_and_hands_it_back_and_what_is_left_is_done(rough_plane):
    leader, root = Watched(0.08), rough_plane.workspace.root
    running = take(rough_plane, "led-1", leader)
    assert find_opening("led-1.red", root) == 0.08
    for key in "rrrrraaaaa":
        leader.press(key)
    wait_until(lambda: not leader.is_moving)
    leader.press(BACK)
    report = running.finish()

    moved_m = read_tool_m(rough_plane, "led-1.red", AFTER) - leader.begin_m
    assert moved_m == pytest.approx((0.0, 0.05, 0.05), abs=0.01)
    assert [each.state for each in report.sessions] == ["replanned", "succeeded"]
    assert report.verdict == "success"
    assert any(line.split() == ["taken", "over", "by", "ada"] for line in why(root, "led-1.red").explanation)


def test_what_a_person_commands_is_guarded_like_anything_else(rough_plane):
    leader = Watched(0.08)
    leader.hurry_m = 1.0
    report = take(rough_plane, "led-2", leader).finish()
    assert report.sessions[0].ended == "skill_failed", report.sessions[0]
    assert report.verdict == "success"
