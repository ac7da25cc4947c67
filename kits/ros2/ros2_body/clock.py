"""The time of a ROS robot: this machine's clock, or `/clock` with `use_sim_time`, which may jump or fall silent."""

import time

from builtin_interfaces.msg import Time
from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node
from target_server.wire import Refusal

JUMP_S = 1.0  # forwards; backwards any jump is one
LOOK_S = 0.001
SILENCE_S = 5.0  # of the machine's time without a message of /clock


class RosClock:
    """Seconds that never run backwards, and stamps of ROS.

    Attributes:
        is_watched: Whether a session moves the robot: elsewhere a jump changes nothing but the time.
        complaint: Of a jump meanwhile; empty without one.
    """

    def __init__(self, node: Node, *, is_simulated: bool) -> None:
        self.is_simulated, self.is_watched, self.complaint = is_simulated, False, ""
        self._clock, self._shift_s = node.get_clock(), 0.0
        limits = {"min_forward": Duration(seconds=JUMP_S), "min_backward": Duration(nanoseconds=-1)}
        threshold = JumpThreshold(**limits, on_clock_change=False)
        self._handle = self._clock.create_jump_callback(threshold, post_callback=self._note_jump)

    @property
    def now_s(self) -> float:
        """The present [s]."""
        return self._read_s() - self._shift_s if self.is_simulated else time.monotonic()

    @property
    def is_running(self) -> bool:
        """Whether there is a time to read: before its first message a simulated one is zero."""
        return not self.is_simulated or self._clock.now().nanoseconds > 0

    def make_stamp(self) -> Time:
        """The present as a message."""
        return self._clock.now().to_msg()

    def read_stamp(self, stamp: Time) -> float:
        """The moment of a message [s]."""
        return self.now_s - (self._read_s() - float(stamp.sec) - float(stamp.nanosec) * 1e-9)

    def _read_s(self) -> float:
        return float(self._clock.now().nanoseconds) * 1e-9

    def wait_until(self, moment_s: float) -> None:
        """Let time pass; raises `Refusal` `TARGET_LOST` when it jumps, or its topic is silent."""
        heard_s, before_s = time.monotonic(), self.now_s
        while (left_s := moment_s - (now_s := self.now_s)) > 0.0:
            if self.complaint:
                raise Refusal("TARGET_LOST", self.complaint)
            if now_s != before_s:
                heard_s, before_s = time.monotonic(), now_s
            elif time.monotonic() - heard_s > SILENCE_S:
                raise Refusal("TARGET_LOST", f"/clock is silent for {SILENCE_S:g} s, with use_sim_time")
            time.sleep(LOOK_S if self.is_simulated else left_s)

    def _note_jump(self, jump: TimeJump) -> None:
        if jump.delta.nanoseconds >= self._clock.now().nanoseconds:
            return  # the first message: time was zero
        delta_s = jump.delta.nanoseconds * 1e-9
        self._shift_s += delta_s
        if self.is_watched:
            self.complaint = f"the clock of ROS jumped by {delta_s:+.3f} s"
