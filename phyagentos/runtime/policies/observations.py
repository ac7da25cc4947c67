"""Observations of a policy: the streams of its descriptor, each from the sensor that provides it.

Simulator truth is no stream, and a camera that does not show the present, as `sensor_health` judges it, is refused.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.policy_descriptors import Stream
from phyagentos.protocol.settings.sensors import Sensors, find_source
from phyagentos.protocol.world.environment import SensorHealth, TargetState
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.perception.sensor_health import assess
from phyagentos.runtime.targets.wire import Frame, Frames

_OF_STATE: Mapping[str, Callable[[TargetState], Any]] = {
    "joint_state": lambda state: state.q_rad,
    "joint_velocity": lambda state: state.qd_rad_s,
    "gripper_width": lambda state: state.gripper_width_m,
    "tool_pose": lambda state: (*state.tcp.position_m, *state.tcp.quaternion_wxyz),
}


@dataclass(slots=True)
class Observer:
    """Collects one observation after the other, for one session.

    Attributes:
        late_max_s: How much older than one period of its stream a frame may be: its latency, and a few lost ones [s].
        health: Of the cameras at the latest observation.
    """

    streams: Mapping[str, Stream]
    sensors: Sensors
    handle: TargetSessionHandle
    late_max_s: float
    health: Mapping[str, SensorHealth]

    def observe(self) -> tuple[float, dict[str, np.ndarray]]:
        """Time of the target [s], and every stream as an array of its declared type.

        Raises:
            ExecutionError: `OBSERVATION_UNAVAILABLE` when a frame is missing, old, dark, dated ahead, repeated or of
                another size; when a value of the target is not finite, or nothing measures a stream.
        """
        cameras = {
            name: self._find_camera(name, each)
            for name, each in self.streams.items()
            if each.modality != "proprioception" or name not in _OF_STATE  # the target measures those itself
        }
        frames = self.handle.capture(tuple(dict.fromkeys(cameras.values()))) if cameras else Frames(())
        now = self.handle.observe()  # after the frames: where time goes on by itself, they were taken before it
        shown: dict[str, np.ndarray] = {}
        for name, stream in self.streams.items():
            if name in cameras:
                frame = self._believe(cameras[name], frames, now.time_s, self.late_max_s + 1.0 / stream.rate_hz)
                shown[name] = _hold_to_form(name, frame.depth_m if stream.modality == "depth" else frame.rgb, stream)
            else:
                shown[name] = _read(name, now.target, stream)
        return now.time_s, shown

    def read_time(self) -> float:
        """The target's own time [s]."""
        return self.handle.observe().time_s

    def _find_camera(self, name: str, stream: Stream) -> str:
        source = find_source(self.sensors, name, stream.frame)
        if source is None or source[1].camera is None:
            raise ExecutionError("OBSERVATION_UNAVAILABLE", f"nothing measures {name!r} in frame {stream.frame!r}")
        return source[0]

    def _believe(self, camera: str, frames: Frames, now_s: float, age_max_s: float) -> Frame:
        believed, self.health = assess(
            frames, self.health, now_s, age_max_s, lambda _frame, _was: self.sensors.get_noise().varies
        )
        for frame in believed:
            if frame.camera == camera:
                return frame
        health = self.health.get(camera, SensorHealth(status="missing", detail="no frame"))
        raise ExecutionError("OBSERVATION_UNAVAILABLE", f"camera {camera!r} is {health.status}: {health.detail}")


def _read(name: str, state: TargetState, stream: Stream) -> np.ndarray:
    value = np.asarray(_OF_STATE[name](state), dtype=stream.dtype)
    if not np.isfinite(value).all():
        raise ExecutionError("OBSERVATION_UNAVAILABLE", f"{name!r} is no number")
    return value


def _hold_to_form(name: str, picture: np.ndarray, stream: Stream) -> np.ndarray:
    if picture.shape != stream.shape:
        found, declared = list(picture.shape), list(stream.shape)
        raise ExecutionError("OBSERVATION_UNAVAILABLE", f"{name!r} has the shape {found}, {declared} is declared")
    return picture
