"""Observations of a policy: the streams of its descriptor, each from the sensor that provides it.

Simulator truth is a stream only where the sensing is `truth`. A camera that does not show the present, as
`sensor_health` judges it, is refused.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from phyagentos.errors import ExecutionError, format_names
from phyagentos.protocol.capabilities.policy_descriptors import WORLD, Stream
from phyagentos.protocol.settings.sensors import Sensors, find_source
from phyagentos.protocol.world.environment import SensorHealth, TargetState
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.perception.sensor_health import assess
from phyagentos.runtime.targets.wire import Frame, Frames, Observation

TIME_TOLERANCE_S = 1e-6  # sums of control periods are not exact
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
        poses: By parameter that names an object: position [m] and quaternion (w, x, y, z) before the first command.
    """

    streams: Mapping[str, Stream]
    sensors: Sensors
    handle: TargetSessionHandle
    late_max_s: float
    health: Mapping[str, SensorHealth]
    poses: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    _past: dict[str, deque[tuple[float, np.ndarray]]] = field(default_factory=dict, init=False)

    def observe(self) -> tuple[float, dict[str, np.ndarray]]:
        """Time of the target [s], and every stream as an array of its declared type, after its history if it has one.

        Raises:
            ExecutionError: `OBSERVATION_UNAVAILABLE` when a frame is missing, old, dark, dated ahead, repeated or of
                another size; when a value of the target is not finite, or nothing measures a stream.
        """
        now_s, shown = self._look(self.streams)
        return now_s, {name: self._recall(name, now_s, each) for name, each in shown.items()}

    def sample(self, now_s: float) -> None:
        """Keep what a history needs of this moment of the target's time; raises as `observe`."""
        due = {
            name: each
            for name, each in self.streams.items()
            if each.history > 1
            and (name not in self._past or now_s - self._past[name][-1][0] >= 1.0 / each.rate_hz - TIME_TOLERANCE_S)
        }
        if due:
            at_s, seen = self._look(due)
            for name, value in seen.items():
                kept = self._past.setdefault(name, deque(maxlen=self.streams[name].history))
                kept.append((at_s, value))

    def _recall(self, name: str, now_s: float, value: np.ndarray) -> np.ndarray:
        """(history, ...) samples, periods of the stream apart, the oldest first; the value alone without one."""
        stream = self.streams[name]
        if stream.history == 1:
            return value
        known = [*self._past.get(name, ()), (now_s, value)]
        moments_s = [now_s - index / stream.rate_hz for index in reversed(range(1, stream.history))]
        past = ([each for at_s, each in known if at_s <= moment_s + TIME_TOLERANCE_S] for moment_s in moments_s)
        return np.stack([*(each[-1] if each else known[0][1] for each in past), value])

    def _look(self, streams: Mapping[str, Stream]) -> tuple[float, dict[str, np.ndarray]]:
        cameras = {
            name: self._find_camera(name, each)
            for name, each in streams.items()
            if each.modality in {"rgb", "depth", "rgbd"}  # the target measures the others itself
        }
        frames = self.handle.capture(tuple(dict.fromkeys(cameras.values()))) if cameras else Frames(())
        now = self.handle.observe()  # after the frames: where time goes on by itself, they were taken before it
        shown: dict[str, np.ndarray] = {}
        for name, stream in streams.items():
            if name == WORLD:
                shown[name] = self._recall_world(stream)
            elif name in cameras:
                frame = self._believe(cameras[name], frames, now.time_s, self.late_max_s + 1.0 / stream.rate_hz)
                shown[name] = _hold_to_form(name, frame.depth_m if stream.modality == "depth" else frame.rgb, stream)
            else:
                shown[name] = _read(name, now, stream)
        return now.time_s, shown

    def _recall_world(self, stream: Stream) -> np.ndarray:
        """(k, 7) poses; where an object went since is unknown."""
        if unseen := [each for each in stream.entities if each not in self.poses]:
            raise ExecutionError("OBSERVATION_UNAVAILABLE", f"{WORLD!r}: not seen before: {format_names(unseen)}")
        return np.array([self.poses[each] for each in stream.entities], dtype=stream.dtype)

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


def _read(name: str, now: Observation, stream: Stream) -> np.ndarray:
    if name not in _OF_STATE and name not in now.signals:
        raise ExecutionError("OBSERVATION_UNAVAILABLE", f"the target measures no {name!r} for a session")
    value = np.asarray(_OF_STATE[name](now.target) if name in _OF_STATE else now.signals[name], dtype=stream.dtype)
    if name not in _OF_STATE:
        shape = tuple(len(now.target.q_rad) if length == "n_joints" else length for length in stream.shape)
        if value.size != math.prod(shape):
            raise ExecutionError("OBSERVATION_UNAVAILABLE", f"{name!r} has {value.size} numbers; {shape} is declared")
        value = value.reshape(shape)
    if not np.isfinite(value).all():
        raise ExecutionError("OBSERVATION_UNAVAILABLE", f"{name!r} is no number")
    return value


def _hold_to_form(name: str, picture: np.ndarray, stream: Stream) -> np.ndarray:
    if picture.shape != stream.shape:
        found, declared = list(picture.shape), list(stream.shape)
        raise ExecutionError("OBSERVATION_UNAVAILABLE", f"{name!r} has the shape {found}, {declared} is declared")
    return picture
