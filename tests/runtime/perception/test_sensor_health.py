"""Whether a camera can be believed: by the noise that it declares, and by its pulse between two whole pictures."""

import math

import msgspec
import numpy as np
import pytest

from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.perception.perceived_world import PROBE_PERIOD_S
from phyagentos.runtime.perception.sensor_health import assess, check_probes, find_probe_regions
from phyagentos.runtime.perception.world_model import HAND
from phyagentos.runtime.targets.wire import Frame, Frames, Observation, Step
from tests.runtime.perception.conftest import Stage, observe_now, redate


def expose(seed, time_s, crop=None):
    """A picture of noise, or of the same still scene for ever when the seed is None."""
    left, top, width, height = crop or (0, 0, 32, 24)
    rng = np.random.default_rng(0 if seed is None else (seed, left, top, width))
    return Frame(
        camera="top",
        time_s=time_s,
        width=width,
        height=height,
        fx=20.0,
        fy=20.0,
        cx=16.0 - left,
        cy=12.0 - top,
        world_T_camera=Pose(),
        rgb=rng.integers(0, 255, (height, width, 3), dtype=np.uint8),
        depth_m=rng.random((height, width), dtype=np.float32),
    )


def take(seed, time_s, before, crops=None, number=-1, **given):
    shown = msgspec.structs.replace(expose(seed, time_s, (crops or {}).get("top")), number=number)
    frames = Frames((shown,))
    if crops:
        return check_probes(frames, before, time_s)
    return assess(frames, before, time_s, 0.3, **given)[1]


@pytest.mark.parametrize(("moved", "status"), [(False, "live"), (True, "frozen")])
def test_a_picture_that_repeats_is_frozen_where_it_would_have_changed(moved, status):
    health = take(None, 1.0, {})
    assert take(None, 2.0, health, would_differ=lambda _frame, _was: moved)["top"].status == status


def test_a_still_picture_is_frozen_where_the_sensors_own_count_stands_and_live_where_it_advances():
    health: dict = {}
    for time_s, number, status in (
        (1.0, 7, "live"),
        (1.5, 8, "live"),
        (2.0, 8, "frozen"),
        (2.0, 8, "frozen"),
        (2.5, 9, "live"),
    ):
        health = take(None, time_s, health, number=number, would_differ=lambda _frame, _was: False)
        assert health["top"].status == status


@pytest.mark.sim
def test_without_noise_a_frozen_picture_is_told_by_the_motion_of_the_arm_and_a_still_scene_is_no_such(twins_library):
    stage = Stage(twins_library, "test/twins", level="none")
    old = stage.take_frames()
    for _ in range(3):
        stage.look(redate(stage.take_frames(), stage.time_s + 0.5))
    assert {each.status for each in stage.belief.sensors.values()} == {"unproven"}  # its frames have no count
    stage.physics.data.qpos[stage.physics.state.q_address] += [0.0, 0.7, 0.0, 0.3, 0.0, 0.1, 0.0]  # down over the table
    stage.physics.queries.look()
    stage.state = stage.physics.queries.read_target({})
    claimed = {frame.camera: frame.world_T_camera for frame in stage.take_frames().frames}
    frozen = Frames(tuple(msgspec.structs.replace(each, world_T_camera=claimed[each.camera]) for each in old.frames))
    honest = stage.belief
    stage.look(redate(frozen, stage.time_s + 0.5))
    assert {each.status for each in stage.belief.sensors.values()} == {"frozen"}
    stage.belief = honest
    stage.look(redate(stage.take_frames(), stage.time_s + 0.5))
    assert {each.status for each in stage.belief.sensors.values()} == {"live"}


def test_a_camera_that_froze_between_two_whole_looks_is_known_by_its_pulse():
    health = take(1, 0.0, {})
    crops = find_probe_regions(health)
    for seed, time_s in ((2, 0.5), (3, 1.0)):
        health = take(seed, time_s, health, crops)
        assert health["top"].status == "live"
    for time_s in (1.5, 2.0):
        health = take(3, time_s, health, crops)
    assert take(3, 2.0, health)["top"].status == "frozen"  # though this whole picture was never seen before
    thawed = take(9, 2.5, health, crops)
    assert take(9, 2.5, thawed)["top"].status == "live"


def test_a_frame_without_a_time_is_stale():
    assert take(1, math.nan, {})["top"].status == "stale"


def test_a_window_that_nobody_asked_for_is_passed_over():
    assert check_probes(Frames((expose(1, 1.0),)), {}, 1.0) == {}


def test_a_pulse_whose_frame_was_lost_tells_nothing():
    health = take(1, 0.0, {})
    crops = find_probe_regions(health)
    health = take(2, 0.5, health, crops)
    again = check_probes(Frames((expose(2, 0.5, crops["top"]),)), health, 0.52)
    assert again["top"].status == "live"


class FreezingHandle:
    """Gives what the cameras of a stage show; from a moment on what they showed then, noise and all, newly stamped."""

    def __init__(self, stage):
        self.stage, self.frozen_qpos, self.asked, self.latest = stage, None, [], None

    def freeze(self):
        self.frozen_qpos = self.stage.physics.data.qpos.copy()

    def capture(self, cameras=(), crops=None, every=1):
        self.asked.append(crops or {})
        number = len(self.asked) if self.frozen_qpos is None else 0
        return self.stage.capture(number, cameras, crops, every, self.frozen_qpos)


class LaggingHandle(FreezingHandle):
    """A world in real time: so much time goes by between an observation and the pictures that are asked for."""

    def __init__(self, stage, lag_s):
        super().__init__(stage)
        self.lag_s = lag_s

    def observe(self):
        self.stage.time_s += self.lag_s
        return observe(self.stage)

    def capture(self, cameras=(), crops=None, every=1):
        self.stage.time_s += self.lag_s
        return super().capture(cameras, crops, every)


def observe(stage):
    return Observation(time_s=stage.time_s, target=stage.state)


@pytest.mark.sim
@pytest.mark.parametrize("lag_s", [0.02, 0.4])
def test_pictures_taken_after_the_observation_are_believed_where_time_goes_on_by_itself(twins, lag_s):
    world = twins.open_world(LaggingHandle(twins, lag_s))
    belief = observe_now(world, twins)
    assert {health.status for health in belief.sensors.values()} == {"live"}
    assert belief.time_s == belief.entities["can"].observed_at_s == twins.time_s - lag_s
    twins.time_s += 0.1
    glanced = observe_now(world, twins, ("can",))
    assert glanced.entities["can"].observed_at_s > belief.time_s


@pytest.mark.sim
def test_a_restored_belief_is_felt_though_nothing_has_been_looked_at_since(twins):
    first, second = (twins.open_world(FreezingHandle(twins)) for _ in range(2))
    belief = observe_now(first, twins)
    second.restore(belief)
    assert observe_now(second, twins).revision == belief.revision
    gripping = twins.grip(belief.entities["can"].pose.position_m, 0.052)
    second._handle.latest = Step(time_s=twins.time_s, target=gripping, tracking_error_rad=0.0)
    second.advance(second._handle.latest)
    assert second.observe(HAND).targets["panda"].holding == ("can",)


@pytest.mark.sim
def test_what_only_frozen_cameras_show_grows_old_though_nobody_looked_around_meanwhile(twins):
    handle = FreezingHandle(twins)
    world = twins.open_world(handle)

    def perceive(*objects):
        return observe_now(world, twins, objects)

    seen = perceive().entities["can"]
    handle.freeze()
    twins.put("can", 0.6, -0.25)
    frozen_s = twins.time_s
    for _ in range(round(2.5 * PROBE_PERIOD_S / 0.02)):
        twins.time_s += 0.02
        world.advance(Step(time_s=twins.time_s, target=twins.state, tracking_error_rad=0.0))
    belief = perceive()
    asked = len(handle.asked)
    glanced = perceive("can")

    assert {health.status for health in belief.sensors.values()} == {"frozen"}
    assert belief.entities["can"].observed_at_s == seen.observed_at_s <= frozen_s
    assert glanced.entities["can"].observed_at_s == seen.observed_at_s
    assert len(handle.asked) == asked
