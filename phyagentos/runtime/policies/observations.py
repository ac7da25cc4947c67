"""What a policy is shown: the streams of its descriptor, each from the sensor that provides it.

Upstream: the target's own state and its cameras. Downstream: `policy_runtime`. Simulator truth is no stream.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from phyagentos.errors import ExecutionError
from phyagentos.protocol.environment import TargetState
from phyagentos.protocol.policies import Stream
from phyagentos.protocol.sensors import Sensors, find_source
from phyagentos.runtime.targets.wire import Frame, Frames

Capture = Callable[[tuple[str, ...]], Frames]
LATE_MAX_S = 0.3  # of a frame, beyond its camera's period: its latency, and a few lost ones

_OF_STATE: Mapping[str, Callable[[TargetState], Any]] = {
    "joint_state": lambda state: state.q_rad,
    "joint_velocity": lambda state: state.qd_rad_s,
    "gripper_width": lambda state: state.gripper_width_m,
    "tool_pose": lambda state: (*state.tcp.position_m, *state.tcp.quaternion_wxyz),
}


@dataclass(frozen=True, slots=True)
class Observer:
    """Collects one observation.

    Attributes:
        streams: What the policy takes.
        sensors: Where it comes from.
        capture: Asks cameras.
    """

    streams: Mapping[str, Stream]
    sensors: Sensors
    capture: Capture

    def observe(self, state: TargetState, time_s: float) -> dict[str, np.ndarray]:
        """Every stream as an array of its declared type.

        Args:
            state: The target's own.
            time_s: Now, in the target's own time [s].

        Raises:
            ExecutionError: `OBSERVATION_UNAVAILABLE` when a camera gave no frame, or an old one, or nothing measures a
                stream.
        """
        return {name: self._read(name, stream, state, time_s) for name, stream in self.streams.items()}

    def _read(self, name: str, stream: Stream, state: TargetState, time_s: float) -> np.ndarray:
        if stream.modality == "proprioception" and name in _OF_STATE:
            return np.asarray(_OF_STATE[name](state), dtype=stream.dtype)
        source = find_source(self.sensors, name, stream.frame)
        if source is None or source[1].camera is None:
            raise ExecutionError("OBSERVATION_UNAVAILABLE", f"nothing measures {name!r} in frame {stream.frame!r}")
        frame = self._look(source[0], time_s, LATE_MAX_S + 1.0 / source[1].rate_hz)
        return frame.depth_m if stream.modality == "depth" else frame.rgb

    def _look(self, camera: str, time_s: float, age_max_s: float) -> Frame:
        frames = self.capture((camera,))
        if not frames.frames:
            reason = frames.missing.get(camera, "no frame")
            raise ExecutionError("OBSERVATION_UNAVAILABLE", f"camera {camera!r}: {reason}")
        frame = frames.frames[0]
        age_s = time_s - frame.time_s
        if not age_s <= age_max_s:  # also when the stamp is NaN
            raise ExecutionError("OBSERVATION_UNAVAILABLE", f"camera {camera!r}: its latest frame is {age_s:.2f} s old")
        return frame
