"""Pause, resume and the emergency stop, on real physics: nothing is commanded meanwhile, and the goal goes on after."""

import json
import threading

import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.estop import Latch, latch, reset
from phyagentos.protocol.sessions.heartbeats import find_heartbeat
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal
from tests.following import wait_until

pytestmark = pytest.mark.journey

CLOCK = SystemClock()
LIMIT_S = 60.0


def is_in_phase(plane, phase: str) -> bool:
    beat = find_heartbeat(plane.workspace.heartbeats, "panda")
    return beat is not None and beat.phase == phase


def count(plane, kind: str) -> int:
    log = plane.workspace.logs / "receive-panda.jsonl"
    if not log.exists():
        return 0
    written, _, _ = log.read_text(encoding="utf-8").rpartition("\n")  # a line may be on its way
    return sum(json.loads(line)["kind"] == kind for line in written.splitlines())


class Running:
    """A goal that is pursued in a thread of its own."""

    def __init__(self, plane, name: str) -> None:
        self.reports = []
        self.thread = threading.Thread(target=lambda: self.reports.append(plane.run(name)), daemon=True)
        self.thread.start()

    def finish(self):
        self.thread.join(LIMIT_S)
        return self.reports[0]


def test_a_paused_session_is_commanded_nothing_until_it_is_resumed(rough_plane):
    plane = rough_plane
    begun = count(plane, "Command")
    running = Running(plane, "paused-1")
    wait_until(lambda: count(plane, "Command") >= begun + 20)
    drop_signal(plane.workspace.signals, Signal(kind="pause", by="test"), CLOCK)
    wait_until(lambda: is_in_phase(plane, "paused"))
    commands = count(plane, "Command")
    CLOCK.sleep(0.5)
    assert is_in_phase(plane, "paused")
    assert count(plane, "Command") == commands

    drop_signal(plane.workspace.signals, Signal(kind="resume", by="test"), CLOCK)
    report = running.finish()

    assert report.verdict == "success", report
    assert [each.state for each in report.sessions] == ["succeeded"]


def test_under_a_latched_emergency_stop_nothing_runs_and_after_a_reset_the_goal_goes_on(rough_plane):
    plane = rough_plane
    signals = plane.workspace.signals.parent
    begun, ended, commands = count(plane, "Begin"), count(plane, "End"), count(plane, "Command")
    running = Running(plane, "stopped-1")
    wait_until(lambda: count(plane, "Command") >= commands + 20)
    latch(signals, Latch(by="test", reason="a hand in the cell"))
    wait_until(lambda: count(plane, "End") == ended + 1)
    commands = count(plane, "Command")
    CLOCK.sleep(1.0)
    assert count(plane, "Command") == commands
    assert count(plane, "Begin") == begun + 1

    reset(signals, "the hand is gone", CLOCK)
    report = running.finish()

    assert report.verdict == "success", report
    assert [(each.state, each.ended) for each in report.sessions] == [
        ("replanned", "safety_stop"),
        ("succeeded", "completed"),
    ]
