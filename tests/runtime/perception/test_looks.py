"""A look that was recorded is perceived again to the same world, from its file alone."""

import math

import msgspec
import numpy as np
import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.looks import LookRole, find_look_problems
from phyagentos.protocol.world.environment import Status
from phyagentos.runtime.perception.look import RecordedFrames
from phyagentos.runtime.perception.look_file import read_look, write_look
from phyagentos.runtime.perception.perceived_world import PROBE_PERIOD_S
from phyagentos.runtime.perception.world_model import BELIEF
from phyagentos.runtime.targets.wire import Step
from phyagentos.runtime.worker.recorder import Recorder
from tests.runtime.perception.conftest import observe_now
from tests.runtime.perception.test_sensor_health import LaggingHandle

pytestmark = pytest.mark.sim


@pytest.fixture
def views(twins):
    """A world that is perceived, one to perceive again with, and a way to let time pass."""
    handle = LaggingHandle(twins, 0.0)
    world = twins.open_world(handle)

    def observe(*objects, after_s=0.1, lag_s=0.0):
        twins.time_s += after_s
        handle.lag_s = lag_s
        return observe_now(world, twins, objects)

    def repeat(path, sha256):
        look = read_look(path, sha256)
        return twins.open_world(RecordedFrames(look)).repeat(look)

    return world, observe, repeat


def test_pictures_and_depths_come_back_bit_for_bit_and_the_file_depends_on_the_look_alone(views, tmp_path):
    world, observe, _ = views
    observe()
    look = world.latest_look
    name, sha256 = write_look(look, tmp_path)
    again = read_look(tmp_path / name, sha256)

    assert [asked for asked, _ in again.captures] == [asked for asked, _ in look.captures]
    for (_, then), (_, now) in zip(look.captures, again.captures, strict=True):
        for one, other in zip(then.frames, now.frames, strict=True):
            assert np.isnan(one.depth_m).any()
            is_same = [
                np.array_equal(a.view("u1"), b.view("u1"))
                for a, b in ((one.rgb, other.rgb), (one.depth_m, other.depth_m))
            ]
            assert is_same == [True, True]  # on their own: pytest spells out how so many bytes differ, for minutes
            assert msgspec.structs.replace(one, rgb=None, depth_m=None) == msgspec.structs.replace(
                other, rgb=None, depth_m=None
            )
    again.file = ""
    assert write_look(again, tmp_path) == (name, sha256)


def test_each_kind_of_look_is_perceived_again_to_the_same_world(views, twins, tmp_path):
    world, observe, repeat = views
    for _ in range(3):
        observe()
    still, moved = (0.62, 0.0), (0.6, -0.25)
    for at_m, objects in ((still, ("can",)), (moved, ()), (moved, ("can", "first")), (moved, ("screen",))):
        twins.put("can", *at_m)
        belief = observe(*objects)
        assert repeat(*_write(world, tmp_path)) == belief, objects


def test_so_is_one_for_which_the_robot_was_asked_again_because_time_went_on(views, tmp_path):
    world, observe, repeat = views
    for lag_s, objects in ((0.4, ()), (0.02, ("can",))):
        belief = observe(*objects, lag_s=lag_s)
        assert world.latest_look.moments
        assert repeat(*_write(world, tmp_path)) == belief, (lag_s, objects)


@pytest.fixture
def glance_at_can(views, twins):
    """Read the frames of a glance at the can that was requested behind a command."""
    world, observe, _ = views
    for _ in range(3):
        observe()
    twins.time_s += 0.6  # an earlier probe is too old
    observe("can")

    def glance(after_s=0.02):
        plan = world.plan_confirmation(frozenset({"can"}), twins.time_s + after_s)
        twins.time_s += after_s
        world._handle.latest = Step(time_s=twins.time_s, target=twins.state, tracking_error_rad=0.0)
        frames = [world._handle.capture(each.cameras, each.crops, each.every) for each in plan.captures]
        world.advance(world._handle.latest, stands=False)
        return plan, world.read_confirmation(plan, frames)

    return glance


def test_a_glance_behind_a_command_gives_the_world_of_a_look_while_the_world_stands(views, glance_at_can, tmp_path):
    world, _, repeat = views
    before = world.observe(BELIEF).entities["can"]
    plan, belief = glance_at_can()

    assert plan.window is not None
    assert belief.entities["can"].observed_at_s > before.observed_at_s
    assert belief.entities["can"].pose == before.pose
    assert repeat(*_write(world, tmp_path)) == belief


def test_a_glance_proves_that_the_cameras_live_when_the_earlier_proof_is_old(glance_at_can):
    assert glance_at_can(after_s=0.02)[0].probe is None
    plan, belief = glance_at_can(after_s=PROBE_PERIOD_S)

    assert {belief.sensors[camera].probed_s for camera in plan.probe.cameras} == {belief.time_s}


@pytest.mark.parametrize("change", ["moved", "early"])
def test_a_glance_that_does_not_show_the_belief_leaves_doubt(views, twins, glance_at_can, change):
    world, _, _ = views
    if change == "moved":
        twins.put("can", 0.6, -0.25)
    else:
        world._handle.lag_s = 0.1
    assert glance_at_can()[1] is None


def test_what_was_seen_once_is_not_confirmed_by_a_glance(views, twins):
    world, observe, _ = views
    observe()
    assert world.plan_confirmation(frozenset({"can"}), twins.time_s + 0.02) is None


def test_a_picture_with_other_pixels_gives_another_world(views, twins, tmp_path):
    world, observe, _ = views
    for _ in range(2):
        belief = observe()
    look = world.latest_look
    for _, frames in look.captures:
        for frame in frames.frames:
            frame.rgb[:] = 0
    assert belief.entities["can"].status is Status.SEEN
    assert world.repeat(look).entities["can"] != belief.entities["can"]


def test_a_damaged_or_missing_file_is_named(views, tmp_path):
    world, observe, _ = views
    observe()
    path, sha256 = _write(world, tmp_path)
    path.write_bytes(path.read_bytes()[:-1] + b"!")
    with pytest.raises(ExecutionError, match=f"EVIDENCE_DAMAGED.*{path.name}"):
        read_look(path, sha256)
    path.unlink()
    with pytest.raises(ExecutionError, match=f"EVIDENCE_DAMAGED.*{path.name}"):
        read_look(path, sha256)


def test_perception_that_reads_something_else_now_refuses(views):
    world, observe, _ = views
    for _ in range(3):
        observe()
    observe("can")
    look = world.latest_look
    look.objects = ("screen",)
    with pytest.raises(ExecutionError, match="CHANGED: perception now asks for"):
        world.repeat(look)


def test_what_a_belief_points_at_is_kept_however_long_ago_it_was_seen(views, twins, tmp_path):
    world, observe, _ = views
    for _ in range(3):
        observe()
    observe("can")
    twins.put("screen", 0.66, 0.05, yaw_rad=0.3)
    for _ in range(3):
        belief = observe()
    recorder = Recorder(tmp_path / "g.a")
    looks = [(LookRole.END, world.latest_look), *((LookRole.POINTED, each) for each in world.find_looks(belief))]
    recorder.write_looks(looks, {})
    assert find_look_problems(tmp_path / "g.a", [belief]) == []

    lost = msgspec.structs.replace(belief.entities["can"], evidence=("top@0.001:1,1,3,3",))
    broken = msgspec.structs.replace(belief, entities=belief.entities | {"can": lost})
    (problem,) = find_look_problems(tmp_path / "g.a", [broken])
    assert (problem.code, problem.found) == ("EVIDENCE_DAMAGED", "top@0.001:1,1,3,3")


def test_a_bundle_that_begins_where_another_ended_shares_its_look(views, tmp_path):
    world, observe, _ = views
    observe()
    for name in ("g.a", "g.b"):
        Recorder(tmp_path / name).write_looks([(LookRole.START, world.latest_look)], {})
    (one,), (other,) = ((tmp_path / name).glob("look-*.zip") for name in ("g.a", "g.b"))
    assert one.samefile(other)


def test_what_is_held_is_perceived_again_as_held(views, twins, tmp_path):
    world, observe, repeat = views
    for _ in range(2):
        belief = observe()
    twins.state = twins.grip(belief.entities["can"].pose.position_m, 0.052)
    belief = observe("can", "first")
    assert belief.entities["can"].status is Status.HELD
    assert repeat(*_write(world, tmp_path)) == belief
    assert math.isclose(belief.time_s, twins.time_s)


def _write(world, folder):
    name, sha256 = write_look(world.latest_look, folder)
    return folder / name, sha256
