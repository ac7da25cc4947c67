"""A policy is shown what is measured now, or nothing."""

import numpy as np
import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.cameras import CameraSettings
from phyagentos.protocol.environment import Pose, TargetState
from phyagentos.protocol.policies import Stream
from phyagentos.protocol.sensors import Sensor, Sensors
from phyagentos.runtime.policies.observations import Observer
from phyagentos.runtime.targets.wire import Frame, Frames

STATE = TargetState(q_rad=(0.1,), qd_rad_s=(0.0,), gripper_width_m=0.08, tcp=Pose())
RGB = np.full((2, 3, 3), 7, dtype=np.uint8)


def observe(stamp_s, time_s=1.0):
    camera = CameraSettings(position_m=(1.0, 0.0, 1.0), target_m=(0.0, 0.0, 0.0), fovy_deg=40.0)
    sensor = Sensor(modality="rgbd", frame="top", rate_hz=10.0, provides=("camera_rgb",), camera=camera)
    frame = Frame(
        camera="top",
        time_s=stamp_s,
        width=3,
        height=2,
        fx=1.0,
        fy=1.0,
        cx=1.5,
        cy=1.0,
        world_T_camera=Pose(),
        rgb=RGB,
        depth_m=np.ones((2, 3), dtype=np.float32),
    )
    stream = Stream(modality="rgb", shape=(2, 3, 3), dtype="uint8", frame="top", rate_hz=10.0)
    observer = Observer({"camera_rgb": stream}, Sensors(sensors={"top": sensor}), lambda _: Frames(frames=(frame,)))
    return observer.observe(STATE, time_s)


def test_a_frame_as_late_as_its_camera_is_shown():
    assert observe(0.8)["camera_rgb"] is RGB


@pytest.mark.parametrize("stamp_s", [0.5, float("nan")])
def test_a_frame_of_a_camera_that_stopped_is_not_shown(stamp_s):
    with pytest.raises(ExecutionError, match="camera 'top': its latest frame is") as refused:
        observe(stamp_s)
    assert refused.value.code == "OBSERVATION_UNAVAILABLE"
