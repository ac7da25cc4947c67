"""A policy is shown what is measured now, or nothing."""

import msgspec
import numpy as np
import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.policy_descriptors import Stream
from phyagentos.protocol.settings.sensors import CameraSettings, NoiseLevel, Sensor, Sensors
from phyagentos.protocol.world.environment import Pose, SensorHealth, TargetState
from phyagentos.runtime.policies.observations import Observer
from phyagentos.runtime.targets.wire import Frame, Frames, Observation

STATE = TargetState(q_rad=(0.1,), qd_rad_s=(0.0,), gripper_width_m=0.08, tcp=Pose())
LATE_MAX_S = 0.3
FROZEN = "camera 'top' is frozen: a new stamp on the same picture"


def expose(stamp_s, shade=7):
    return Frame(
        camera="top",
        time_s=stamp_s,
        width=3,
        height=2,
        fx=1.0,
        fy=1.0,
        cx=1.5,
        cy=1.0,
        world_T_camera=Pose(),
        rgb=np.full((2, 3, 3), shade, dtype=np.uint8),
        depth_m=np.ones((2, 3), dtype=np.float32),
    )


class Handle:
    """Its camera gives one frame after the other; its time goes on by `lag_s` with every question."""

    def __init__(self, frames, time_s=1.0, lag_s=0.0, state=STATE, signals=None):
        self.frames, self.time_s, self.lag_s, self.state = list(frames), time_s, lag_s, state
        self.signals = signals or {}
        self.asked = []

    def capture(self, cameras):
        self.asked.append(cameras)
        self.time_s += self.lag_s
        return self.frames.pop(0)

    def observe(self):
        self.time_s += self.lag_s
        return Observation(time_s=self.time_s, target=self.state, signals=self.signals)


def open_eye(*frames, rate_hz=10.0, health=None, color_std=1.0, **given):
    camera = CameraSettings(position_m=(1.0, 0.0, 1.0), target_m=(0.0, 0.0, 0.0), fovy_deg=40.0)
    provided = ("camera_rgb", "camera_depth")
    sensor = Sensor(modality="rgbd", frame="top", rate_hz=10.0, provides=provided, camera=camera)
    sensors = Sensors(
        sensors={"top": sensor}, noise_level="some", noise_levels={"some": NoiseLevel(color_std=color_std)}
    )
    told = [each if isinstance(each, Frames) else Frames((each,)) for each in frames]
    streams = {
        "camera_rgb": Stream(modality="rgb", shape=(2, 3, 3), dtype="uint8", frame="top", rate_hz=rate_hz),
        "camera_depth": Stream(modality="depth", shape=(2, 3), frame="top", rate_hz=rate_hz),
        "joint_state": Stream(modality="proprioception", shape=(1,), rate_hz=10.0),
    }
    return Observer(streams, sensors, Handle(told, **given), LATE_MAX_S, health or {})


def find_refusal(observer):
    with pytest.raises(ExecutionError) as refused:
        observer.observe()
    assert refused.value.code == "OBSERVATION_UNAVAILABLE"
    return str(refused.value)


def test_a_frame_as_late_as_its_camera_is_shown_and_one_exposure_gives_colour_and_depth():
    frame = expose(0.8)
    observer = open_eye(frame)
    time_s, shown = observer.observe()
    assert (time_s, observer.handle.asked) == (1.0, [("top",)])
    assert shown["camera_rgb"] is frame.rgb
    assert shown["camera_depth"] is frame.depth_m
    assert shown["joint_state"] == pytest.approx([0.1])


@pytest.mark.parametrize(
    ("told", "why"),
    [
        (expose(0.5), "stale: its latest frame is 0.50 s old"),
        (expose(float("nan")), "stale: its latest frame is nan s old"),
        (expose(1.5), "stale: its frame is dated 0.50 s ahead"),
        (Frames((), {"top": "OBSERVATION_UNAVAILABLE"}), "missing: OBSERVATION_UNAVAILABLE"),
        (Frames(()), "missing: no frame"),
    ],
    ids=["old", "timeless", "ahead", "silent", "nothing"],
)
def test_a_camera_that_does_not_show_the_present_shows_nothing(told, why):
    assert f"camera 'top' is {why}" in find_refusal(open_eye(told))


def test_a_picture_of_another_size_than_declared_is_not_shown():
    cut = msgspec.structs.replace(expose(1.0), rgb=np.zeros((1, 3, 3), dtype=np.uint8))
    assert "'camera_rgb' has the shape [1, 3, 3], [2, 3, 3] is declared" in find_refusal(open_eye(cut))


def test_a_joint_whose_reading_is_no_number_shows_nothing():
    state = msgspec.structs.replace(STATE, q_rad=(float("nan"),))
    assert "'joint_state' is no number" in find_refusal(open_eye(expose(1.0), state=state))


@pytest.mark.parametrize(("rate_hz", "is_shown"), [(10.0, False), (2.0, True)])
def test_how_old_a_frame_may_be_is_what_the_policy_declares(rate_hz, is_shown):
    observer = open_eye(expose(0.5), rate_hz=rate_hz)
    if is_shown:
        observer.observe()
    else:
        find_refusal(observer)


def test_a_picture_that_comes_again_with_a_new_stamp_is_of_a_frozen_camera():
    observer = open_eye(expose(1.0, 1), expose(1.0, 1), expose(1.2, 2), expose(1.4, 2))
    for time_s in (1.0, 1.1, 1.2):
        observer.handle.time_s = time_s
        observer.observe()
    observer.handle.time_s = 1.4
    assert FROZEN in find_refusal(observer)


def test_without_declared_noise_a_still_scene_and_a_frozen_camera_that_lies_are_the_same():
    observer = open_eye(expose(1.0), expose(1.0), color_std=0.0)
    observer.observe()
    observer.handle.time_s = 1.2
    observer.observe()


def test_a_camera_that_froze_before_the_session_shows_nothing_at_all():
    known = SensorHealth(status="frozen", time_s=0.9, liveness_probe="abc@0.9")
    assert FROZEN in find_refusal(open_eye(expose(1.0), health={"top": known}))


def test_where_time_goes_on_meanwhile_a_picture_is_as_old_as_the_world_says():
    assert open_eye(expose(1.2), lag_s=0.2).observe()[0] == pytest.approx(1.4)
    assert "its latest frame is 0.50 s old" in find_refusal(open_eye(expose(0.9), lag_s=0.2))


def test_where_objects_were_believed_to_be_is_shown_in_the_order_of_their_parameters():
    stream = Stream(modality="simulator_state", shape=(2, 7), dtype="float64", rate_hz=10.0, entities=("cup", "shelf"))
    poses = {"shelf": (1.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0), "cup": (0.5, 0.1, 0.0, 0.0, 0.0, 0.0, 1.0)}
    observer = Observer({"environment_state": stream}, Sensors(sensors={}), Handle([]), LATE_MAX_S, {}, poses)

    _, shown = observer.observe()
    assert shown["environment_state"].tolist() == [list(poses["cup"]), list(poses["shelf"])]

    del poses["cup"]
    assert "'environment_state': not seen before: cup" in find_refusal(observer)


@pytest.mark.parametrize(
    ("signals", "why"),
    [
        ({"scan": (1.0, 2.0, 3.0, 4.0)}, ""),
        ({}, "the target measures no 'scan' for a session"),
        ({"scan": (1.0, 2.0)}, "'scan' has 2 numbers; (2, 2) is declared"),
        ({"scan": (1.0, 2.0, 3.0, float("nan"))}, "'scan' is no number"),
    ],
    ids=["as declared", "not at all", "another size", "nonsense"],
)
def test_a_further_measurement_of_the_target_is_shown_in_its_declared_form(signals, why):
    streams = {"scan": Stream(modality="simulator_state", shape=(2, 2), rate_hz=10.0)}
    observer = Observer(streams, Sensors(sensors={}), Handle([], signals=signals), LATE_MAX_S, {})
    if why:
        assert why in find_refusal(observer)
    else:
        assert observer.observe()[1]["scan"].tolist() == [[1.0, 2.0], [3.0, 4.0]]
