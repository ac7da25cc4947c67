"""Cameras that do not stand where they say are told, and not believed."""

import math

import msgspec
import numpy as np
import pytest

from phyagentos.geometry import as_pose, compute_rotation
from phyagentos.runtime.targets.wire import Frames

pytestmark = pytest.mark.sim


def shift(frames, camera, by_m):
    """The frames, one of which claims to be taken elsewhere: `by_m` (3,) in the world."""
    return Frames(
        tuple(
            msgspec.structs.replace(
                each,
                world_T_camera=as_pose(
                    compute_rotation(each.world_T_camera.quaternion_wxyz),
                    np.array(each.world_T_camera.position_m) + by_m,
                ),
            )
            if each.camera == camera
            else each
            for each in frames.frames
        )
    )


@pytest.mark.parametrize(("by_m", "beside"), [((0.0, 0.0, 0.03), "the map"), ((0.03, 0.02, 0.0), "the other cameras")])
def test_a_camera_that_is_shifted_is_displaced_and_objects_are_where_the_others_see_them(twins, by_m, beside):
    seen = twins.look(shift(twins.take_frames(), "overhead", by_m), after_s=0.1)
    assert {name: each.status for name, each in seen.sensors.items() if each.status != "live"} == {
        "overhead": "displaced"
    }
    assert seen.sensors["overhead"].detail.endswith(beside)
    assert math.dist(seen.entities["can"].pose.position_m, twins.find("can")) < 0.006


def test_it_is_believed_again_only_after_a_while(twins):
    twins.look(shift(twins.take_frames(), "overhead", (0.0, 0.0, 0.03)), after_s=0.1)
    assert twins.look().sensors["overhead"].status == "displaced"
    assert twins.look(after_s=10.0).sensors["overhead"].status == "live"
