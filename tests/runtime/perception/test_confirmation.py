"""A glance confirms what stands still with a few pixels, and finds at once what does not."""

import math

import numpy as np
import pytest

from phyagentos.protocol.world.environment import Status
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.drivers.mujoco.simulated_camera import pose_state
from phyagentos.runtime.perception.confirmation import confirm, is_settled
from tests.runtime.perception.conftest import Stage, judge, observe_now

pytestmark = pytest.mark.sim
GLANCE_S = 0.1


class CountingHandle:
    """Gives what the cameras of a stage show, and keeps what was asked for: how thinned, and how many pixels came.

    A share `lost` of all pixels has no depth.
    """

    def __init__(self, stage):
        self.stage, self.asked, self.looks, self.latest, self.lost = stage, [], 0, None, 0.0

    def capture(self, cameras=(), crops=None, every=1):
        self.looks += 1
        found, rng = self.stage.capture(self.looks, cameras, crops, every), np.random.default_rng(self.looks)
        for frame in found.frames:
            frame.depth_m[rng.random(frame.depth_m.shape) < self.lost] = np.nan
        if crops and all(window[2:] != (12, 12) for window in crops.values()):
            self.asked.append((every, sum(frame.width * frame.height for frame in found.frames)))
        return found


@pytest.fixture(scope="module")
def stage(twins_library):
    return Stage(twins_library, "test/twins")


@pytest.fixture(scope="module")
def looked(stage):
    """What watches the stage, and what it believes after three looks around."""
    handle = CountingHandle(stage)
    world = stage.open_world(handle)

    def glance(*names):
        stage.time_s += GLANCE_S
        return observe_now(world, stage, names)

    for _ in range(3):
        belief = glance()
    return world, handle, glance, belief, (handle.looks, stage.time_s, stage.physics.data.qpos.copy())


@pytest.fixture
def watched(stage, looked):
    """The stage as it was after these looks, its handle, and a look at an object; noise alike in any order of tests."""
    world, handle, glance, belief, (handle.looks, stage.time_s, qpos) = looked
    stage.physics.data.qpos[:] = qpos
    world.restore(belief)
    handle.asked.clear()
    return stage, handle, glance


@pytest.mark.parametrize(("name", "every"), [("can", 1), ("screen", 3)])
def test_what_stands_still_is_confirmed_by_a_few_pixels_and_its_pose_stays(watched, name, every):
    stage, handle, glance = watched
    before = glance(name)
    handle.asked.clear()
    after = [glance(name) for _ in range(12)]

    assert {thinned for thinned, _ in handle.asked[:1]} == {every}
    assert len(handle.asked) < 1.3 * len(after)  # an uncertainty costs a second window
    assert sum(pixels for _, pixels in handle.asked) / len(after) < 1200  # of four pictures of 27648
    assert after[-1].entities[name].observed_at_s == stage.time_s
    assert math.dist(after[-1].entities[name].pose.position_m, before.entities[name].pose.position_m) < 0.001
    assert [now.revision for now in after] == list(range(before.revision + 1, before.revision + 13))
    assert after[-1].sensors.keys() == before.sensors.keys()
    camera, _, rest = after[-1].entities[name].evidence[0].partition("@")
    left, top, width, height = (int(part) for part in rest.partition(":")[2].split(","))
    lens, place = stage.cameras[camera].mounting.lens, before.sensors[camera].pose
    assert place is not None
    assert (0 < left < left + width < lens.width, 0 < top < top + height < lens.height) == (True, True)


@pytest.mark.parametrize(("lost", "most"), [(0.4, 1.3), (0.9, 3.0)])
def test_an_object_of_glass_is_confirmed_by_the_depth_that_it_has_and_found_where_it_was_moved(
    watched, monkeypatch, lost, most
):
    stage, handle, glance = watched
    monkeypatch.setattr(handle, "lost", lost)
    looks = [glance("can") for _ in range(10)]
    asked = len(handle.asked) / len(looks)
    x_m, y_m, _ = stage.find("can")
    stage.put("can", x_m + 0.012, y_m - 0.016)
    after = glance("can").entities["can"]

    assert most - 2.0 < asked < most
    is_known_elsewhere = math.dist(after.pose.position_m, stage.find("can")) < 0.008
    assert is_known_elsewhere or after.status is not Status.SEEN


@pytest.mark.parametrize("by_m", [0.015, 0.02, 0.05])
@pytest.mark.parametrize("name", ["can", "first"])
def test_what_was_moved_is_found_where_it_is_by_the_very_next_glance(watched, name, by_m):
    stage, _, glance = watched
    before = glance(name).entities[name].pose.position_m
    real = min(("first", "second"), key=lambda each: math.dist(stage.find(each), before)) if name == "first" else name
    x_m, y_m, _ = stage.find(real)
    stage.put(real, x_m + 0.6 * by_m, y_m + 0.8 * by_m * (-1 if y_m < 0 else 1))
    after = glance(name).entities[name]

    is_known_elsewhere = math.dist(after.pose.position_m, stage.find(real)) < 0.006
    assert is_known_elsewhere or after.status is not Status.SEEN


@pytest.mark.parametrize(
    "puts",
    [
        pytest.param({"can": (2.5, 2.5)}, id="taken away"),
        pytest.param({"can": (2.5, 2.5), "first": (0.62, 0.0)}, id="another object in its place"),
        pytest.param({"can": (2.5, 2.5), "screen": (0.66, 0.05, None, 0.3)}, id="behind a screen"),
    ],
)
def test_what_is_not_there_any_more_is_not_believed_after_the_next_glance(watched, puts):
    stage, _, glance = watched
    seen_at_s = glance("can").entities["can"].observed_at_s
    for name, place in puts.items():
        stage.put(name, *place)
    after = glance("can")

    assert after.entities["can"].status is not Status.SEEN
    assert after.entities["can"].observed_at_s == pytest.approx(seen_at_s)
    assert judge("upright(can)", after) is Truth.UNKNOWN


def test_what_fell_over_is_known_to_lie_after_the_next_glance(watched):
    stage, _, glance = watched
    glance("can")
    stage.put("can", 0.62, 0.0, z_m=0.026, yaw_rad=0.6, tilt_rad=math.pi / 2)

    assert judge("upright(can)", glance("can")) is not Truth.TRUE


def test_an_object_that_moved_at_the_last_look_is_not_settled(watched):
    stage, _, glance = watched
    belief = glance("can")
    item = stage.pipeline.inventory.objects["can"]
    assert is_settled(belief.entities["can"], item)
    stage.put("can", 0.6, -0.25)
    moved = glance("can").entities["can"]
    assert not is_settled(moved, item)
    assert not is_settled(None, item)


def test_a_window_in_which_nothing_was_measured_confirms_nothing(watched):
    stage, _, glance = watched
    belief = glance("can")
    data = pose_state(stage.physics.model, stage.physics.data.qpos)
    camera = next(iter(belief.entities["can"].evidence)).partition("@")[0]
    frame = stage.cameras[camera].capture(data, stage.time_s, np.random.default_rng(1))
    labels = np.full(frame.depth_m.shape, stage.pipeline.inventory.objects["can"].colors[0], np.uint8)
    frame.depth_m[:] = np.nan
    item, focal_px = stage.pipeline.inventory.objects["can"], belief.sensors[camera].focal_px
    assert confirm(item, belief.entities["can"], frame, labels, focal_px) is None
