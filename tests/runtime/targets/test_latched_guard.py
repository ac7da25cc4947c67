"""The worker's guard looks at the latch itself: it refuses although the target hears of no stop."""

import json

import numpy as np
import pytest

from benchmarks.recorded import open_robot
from phyagentos.assembly.worker_process import open_handle, read_site
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.estop import Latch, latch, reset
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Entity, Environment, Pose, Shape, ShapeKind
from phyagentos.runtime.actions.handle import CommandRefused
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.server import Loopback

pytestmark = pytest.mark.sim


@pytest.fixture
def workspace(tmp_path, library):
    return Workspace.create(tmp_path / "workspace", library)


@pytest.fixture
def handle(make_rig, workspace, tmp_path, library):
    rig = make_rig(log=tmp_path / "receive.jsonl")  # a target that listens to nobody
    handle = open_handle(Loopback(rig.world), open_robot().limits, workspace, library.get_target("panda"))
    handle.load(Scene(name="tabletop/cubes_and_trays", seed=1, episode="e"))
    return handle


def stand_still(q_rad):
    return SetPoints(np.tile(q_rad, (10, 1)), np.zeros((10, 7)), np.full(10, 0.08))


def test_a_latched_stop_is_refused_by_the_guard_of_a_worker_whose_target_would_obey(handle, workspace, tmp_path):
    signals = workspace.signals.parent
    still = stand_still(handle.begin("s", 1).target.q_rad)
    handle.apply(still)
    latch(signals, Latch(by="a button"))
    with pytest.raises(CommandRefused) as refused:
        handle.apply(still)
    lines = [json.loads(line) for line in (tmp_path / "receive.jsonl").read_text().splitlines()]

    assert (refused.value.by, refused.value.code, refused.value.reaction) == ("guard", "ESTOPPED", "stop_category_1")
    assert [line["kind"] for line in lines].count("Command") == 1  # the second one never reached the target
    assert lines[-1]["kind"] == "Halt"


def test_a_body_that_a_worker_holds_hears_of_the_stop_that_the_guard_has_seen_first(tmp_path, monkeypatch):
    space = Workspace.create(tmp_path / "w", Library.open(find_shipped_root() / "benchmarks" / "library"))
    local, heard = read_site(space, "counter", SystemClock()).local, []
    monkeypatch.setattr(local.driver, "emergency_stop", lambda: heard.append("stop"))
    assert isinstance(local.handle(wire.LoadScene("counter", 1, "e")), wire.Loaded)
    assert isinstance(local.handle(wire.Begin("s", 1)), wire.Ack)
    latch(space.signals.parent, Latch(by="a button"))
    assert isinstance(local.handle(wire.Halt("s", 1)), wire.Step)
    assert isinstance(local.handle(wire.End("s", 1)), wire.Ended)
    assert heard == ["stop"]


def test_a_session_after_the_reset_is_let_through_again(handle, workspace):
    signals = workspace.signals.parent
    latch(signals, Latch(by="a button"))
    still = stand_still(handle.begin("s", 1).target.q_rad)
    with pytest.raises(CommandRefused, match="guard"):
        handle.apply(still)
    handle.end()
    reset(signals, "the button was pressed by mistake", SystemClock())
    still = stand_still(handle.begin("t", 1).target.q_rad)

    assert handle.apply(still).time_s > 0.0


def test_a_posture_that_reaches_into_what_stands_fixed_is_refused_by_the_guard_of_a_worker(handle):
    start = np.array(handle.begin("s", 1).target.q_rad)
    shape = Shape(kind=ShapeKind.BOX, size_m=(0.3, 0.02, 0.4))
    wall = Entity(name="screen", kind="wall", pose=Pose((0.45, 0.3, 0.45)), shapes=(shape,), movable=False)
    scene = {"scene": "s", "episode": "e", "revision": 1, "sensing": "perceived"}
    handle.guard_against(Environment(time_s=0.0, entities={"screen": wall}, **scene))
    with pytest.raises(CommandRefused) as refused:
        swing(handle, start, periods=75)
    assert (refused.value.by, refused.value.violation.code) == ("guard", "COLLISION")
    assert refused.value.violation.where.endswith("|screen")


def swing(handle, start, periods):
    """Turn the first joint from rest at 1 rad/s^2."""
    for period in range(periods):
        t = 0.02 * period + 0.002 * np.arange(1, 11)
        q, qd = np.tile(start, (10, 1)), np.zeros((10, 7))
        q[:, 0] += 0.5 * t**2
        qd[:, 0] = t
        handle.apply(SetPoints(q, qd, np.full(10, 0.08)))
