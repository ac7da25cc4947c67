"""A robot of LeRobot as a body of the kit: set-points paced by this machine's clock, velocities, rest, pictures.

LeRobot has positions only, and no stop: velocities are differences over a window, and every stop is a braking motion to
where the robot then holds.
"""

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np
from target_server.body import Body, Joint, Picture, State, Window
from target_server.exposure import Exposure
from target_server.kinematics import Chain, brake, make_pose, to_quaternion
from target_server.wire import Refusal

from lerobot_robot.device import Device, Reading
from lerobot_robot.settings import Settings

VELOCITY_S = 0.1  # window of velocities: one step of a servo is 0.015 rad/s
REST = 0.018  # slower joints are at rest [rad/s or m/s]
REST_READINGS = 3
HALT_MAX_S = 2.0
FRESH_SHARE = 0.5  # of a step: so old a reading is the present
KEPT = 64  # set-points that may not be reached yet
MM = 0.001
SLACK = 1e-6  # of a step


class LeRobotBody(Body):
    """One robot that is connected; an episode begins where it stands."""

    driver, is_realtime = "lerobot", True

    def __init__(self, settings: Settings, device: Device) -> None:
        self._settings, self._device, given = settings, device, settings.lerobot
        self.target, self.step_s = settings.target, settings.step_s
        self.steps_per_command = round(settings.period_s / settings.step_s)
        self.end_effector, self.cameras = settings.end_effector, tuple(given.cameras)
        self.tcp_m, self.width_max_m = given.tool.position_m, settings.width_max_m
        self.gripper_force_n = settings.finger_force_n
        rows = [
            (name, given.joints[name], speed) for name, speed in zip(settings.joints, settings.velocity, strict=True)
        ]
        self.joints = [Joint(n, j.low, j.high, speed, j.axis, j.anchor_m, j.slides) for n, j, speed in rows]
        self._chain = Chain(self.joints, given.tool)
        opens = ("gripper_width",) if given.gripper is not None else ()
        sees: tuple[str, ...] = ("camera_rgb",) if given.cameras else ()
        sees += ("entity_poses", "camera_depth") if any(each.depth for each in given.cameras.values()) else ()
        self.observations, self.actions = ("joint_state", *opens, *sees), ("joint_position", *opens)
        self._past: deque[Reading] = deque()
        self._sent: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=KEPT)  # when it is reached, and what
        self._zero_s = self._row_s = time.monotonic()
        self._q: tuple[float, ...] = ()
        self._qd: tuple[float, ...] = ()
        self._width_m = self._wanted_m = 0.0
        self._take()

    @property
    def time_s(self) -> float:
        """The present, in whole steps since the latest row."""
        return self._row_s + self._count_steps() * self.step_s - self._zero_s

    def _count_steps(self) -> int:
        return math.floor((time.monotonic() - self._row_s) / self.step_s + SLACK)

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        """An episode begins where the robot stands; nothing moves."""
        if snapshot:
            raise Refusal("MALFORMED", "a real robot cannot be put into the state of a snapshot")
        self._take()

    def read(self) -> State:
        now = self._observe()
        pose = self._chain.locate(now.q)
        x, y, z = pose[:3, 3].tolist()
        return State(now.q, self._measure_speeds(), (x, y, z), to_quaternion(pose[:3, :3]), width_m=now.width_m)

    def _observe(self) -> Reading:
        """The present: the latest reading, or a new one."""
        past = self._past
        if not past or time.monotonic() - past[-1].at_s > FRESH_SHARE * self.step_s:
            past.append(self._device.read())
            while len(past) > 1 and past[1].at_s <= past[-1].at_s - VELOCITY_S:
                past.popleft()
        return past[-1]

    def _measure_speeds(self) -> tuple[float, ...]:
        first, last = self._past[0], self._past[-1]
        if last.qd is not None:
            return last.qd
        lasted_s = max(last.at_s - first.at_s, VELOCITY_S)
        return tuple((b - a) / lasted_s for a, b in zip(first.q, last.q, strict=True))

    def measure_error(self, wanted: Sequence[float]) -> float:
        """Against what is to be reached by now, of what was sent."""
        due = [q for moment_s, q in self._sent if moment_s <= time.monotonic()]
        return super().measure_error(due[-1] if due else self.read().q)

    def step(self, q: Sequence[float], qd: Sequence[float], width_m: float) -> str:
        self._await_step()
        self._observe()  # what is not seen is not moved
        self._q, self._qd, self._wanted_m = tuple(q), tuple(qd), width_m
        if self._send():
            return ""
        self.halt(2)
        return "TARGET_LIMIT"

    def stay(self) -> None:
        self._await_step()
        if self._width_m != self._wanted_m:
            self._send()
        self._observe()

    def _await_step(self) -> None:
        """Until the next whole step begins."""
        self._row_s += (self._count_steps() + 1) * self.step_s
        time.sleep(max(self._row_s - time.monotonic(), 0.0))

    def _send(self) -> bool:
        """The present set-point, fingers on their way at the profile's speed; whether it was sent on as it is."""
        way_m = self._settings.finger_speed_m_s * self.step_s
        self._width_m += min(max(self._wanted_m - self._width_m, -way_m), way_m)
        self._sent.append((time.monotonic() + self.step_s + self._settings.lerobot.lag_s, self._q))
        return self._device.send(self._q, self._qd, self._width_m)

    def halt(self, category: int) -> None:
        if any(self._qd):
            start, speeds, passed_s = self._q, self._qd, 0.0
            _, lasts_s = brake(start, speeds, self._settings.acceleration)
            while passed_s < lasts_s:
                passed_s = min(passed_s + self.step_s, lasts_s)
                way_s, share = passed_s - 0.5 * passed_s**2 / lasts_s, 1.0 - passed_s / lasts_s
                rows = zip(start, speeds, self.joints, strict=True)
                self._q = tuple(min(max(q + way_s * qd, each.low), each.high) for q, qd, each in rows)
                self._qd = tuple(share * qd for qd in speeds)
                self._await_step()
                self._send()
        self._await_rest()

    def _await_rest(self) -> None:
        """Until the joints stand in several readings; the robot is then held where it stands."""
        still, end_s = 0, time.monotonic() + HALT_MAX_S
        while still < REST_READINGS and time.monotonic() < end_s:
            self._await_step()
            still = still + 1 if max(map(abs, self.read().qd)) < REST else 0
        width_m, wanted_m = self._width_m, self._wanted_m
        self._take()
        self._width_m, self._wanted_m = width_m, wanted_m

    def _take(self) -> None:
        """Set-points go on from where the robot stands."""
        now = self._observe()
        self._q, self._qd, self._width_m = now.q, (0.0,) * len(now.q), now.width_m
        self._wanted_m = self._width_m
        self._sent.clear()

    def capture(self, cameras: Sequence[str], windows: Mapping[str, Window], every: int) -> Sequence[Picture]:
        known = self._settings.lerobot.cameras
        if unknown := [name for name in (*cameras, *windows) if name not in known]:
            raise Refusal("REQUEST_INVALID", f"no camera {unknown[0]!r}; there are {', '.join(known) or 'none'}")
        now, found = self._observe(), []
        for name in cameras or known:
            each = known[name]
            rgb = np.asarray(now.seen[each.color])
            depth = np.asarray(now.seen[each.depth]) if each.depth else np.zeros(rgb.shape[:2])
            if rgb.shape != (*depth.shape[:2], 3):
                message = f"{name}: colours {rgb.shape} and depth {depth.shape}: not registered"
                raise Refusal("OBSERVATION_UNAVAILABLE", message)
            pose = make_pose(each.position_m, each.quaternion_wxyz)
            pose = self._chain.locate(now.q) @ pose if each.on_tool else pose
            at_s, depth = now.at_s - self._zero_s, depth.reshape(depth.shape[:2])
            exposure = Exposure(name, at_s, rgb, depth, MM, each.focal_px, each.center_px)
            found.append(exposure.develop(pose, windows.get(name), every))
        return found

    def close(self) -> None:
        self._device.close()
