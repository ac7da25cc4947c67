"""Hops are counted below the deepest function that two waypoints share; a message is one; returning costs nothing."""

import importlib.util
import sys
from pathlib import Path

import pytest

FILE = Path(__file__).parents[2] / "tools" / "count_hops.py"


@pytest.fixture(scope="module")
def hops():
    spec = importlib.util.spec_from_file_location("count_hops", FILE)
    module = sys.modules["count_hops"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["count_hops"]


def run_of(hops, *events):
    run = object.__new__(hops.Run)
    run.events = [
        hops.Event(at, 1 if role == "worker" else 2, role, name, tuple((n, "f.py", n) for n in stack), **more)
        for at, (role, name, stack, more) in enumerate(events, 1)
    ]
    return run


@pytest.fixture
def run(hops):
    tag = "\x82\xa4type\xa7Command"
    return run_of(
        hops,
        ("worker", "CommandBuffer.set_arm", ["Loop.run", "tick", "update", "set_arm"], {}),
        ("worker", "SafetyGuard.judge", ["Loop.run", "apply", "judge"], {}),
        ("worker", "Connection._send_bytes", ["Loop.run", "apply", "send"], {"message": "a", "head": tag}),
        ("world", "Connection._recv_bytes", ["serve", "receive"], {"message": "a", "head": tag}),
        ("world", "mj_step", ["serve", "follow"], {}),
    )


def test_a_way_counts_calls_below_what_its_waypoints_share_and_messages(hops, run):
    way = hops.ApproachCandidate(run, run.events[0], loop="Loop")
    way.call("guard", "worker")
    way.send("Command", "worker", "world")
    way.step()

    expected = ["tick", "update", "set_arm", "apply", "judge", "send", "message Command", "follow"]
    assert [hop.name for hop in way.hops] == expected


def test_a_function_that_was_called_again_is_another_one(hops, run):
    again = hops.Event(9, 1, "worker", "SafetyGuard.judge", ((7, "f.py", "Loop.run"), (8, "f.py", "judge")))
    run.events.append(again)
    way = hops.ApproachCandidate(run, run.events[2])
    way.call("guard", "worker")

    assert [hop.name for hop in way.hops] == ["Loop.run", "judge"]


def test_a_waypoint_that_is_not_there_is_named(hops, run):
    way = hops.ApproachCandidate(run, run.events[0])
    with pytest.raises(hops.WaypointMissing, match="'queue' in the watchdog: none of"):
        way.call("queue", "watchdog")
