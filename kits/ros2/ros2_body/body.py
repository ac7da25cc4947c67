"""The robot as a body of the kit: measured joints in, set-points out, its own stop, its cameras.

Set-points are written when their turn begins and reached `lead_s` after it ends: that hides what a message takes on its
way. Between sessions nothing is sent; the robot's controller holds.
"""

import contextlib
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from target_server.body import Body, Joint, Picture, State, Window
from target_server.kinematics import Array, Chain, brake, to_quaternion
from target_server.procedures import Call
from target_server.settings import SettingsError
from target_server.wire import Refusal

from ros2_body.cameras import Cameras
from ros2_body.clock import RosClock
from ros2_body.controller_manager import ControllerWatch
from ros2_body.controllers import ForwardSender, GripperSender, Point, Sender, TrajectorySender
from ros2_body.joint_reader import JointReader, Measured
from ros2_body.procedures import Procedures
from ros2_body.settings import FILE, Settings, list_ros_names
from ros2_body.wrench_reader import WrenchReader

WRENCH = "wrench"
REST = 0.01  # slower joints are at rest [rad/s or m/s]
REST_READINGS = 3
HALT_MAX_S = 2.0
MOVING_M_S = 0.01  # fingers that move faster press on nothing
LOOK_S = 0.02
SLACK = 1e-6  # of a step


class Ros2Body(Body):
    """One robot; raises `SettingsError` where what `ros2.yaml` names is not there within `wait_s`."""

    driver, is_realtime = "ros2", True

    def __init__(self, settings: Settings) -> None:
        self._settings, ros = settings, settings.ros
        self._describe()
        self._names = list_ros_names(settings)
        self._fingers = list(ros.gripper.joints) if ros.gripper is not None else []
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        overrides = [Parameter("use_sim_time", Parameter.Type.BOOL, ros.use_sim_time)]
        self._node = Node("phyagentos_target", namespace=ros.namespace or None, parameter_overrides=overrides)
        self._clock = RosClock(self._node, is_simulated=ros.use_sim_time)
        self._reader = JointReader(self._node, ros.joint_states, self._clock)
        self._wrench = WrenchReader(self._node, ros.wrench, self._clock) if ros.wrench is not None else None
        self._open_senders()
        self._open_stop()
        self._chain = Chain(self.joints, ros.tool)
        self._cameras = Cameras(self._node, ros, self._clock, self._locate_tool)
        self._procedures = Procedures(self._node, ros.procedures)
        self.procedures = self._procedures.described
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, daemon=True, name="ros")
        self._thread.start()
        self._zero_s = self._row_s = 0.0
        self._q: tuple[float, ...] = ()
        self._qd: tuple[float, ...] = ()
        self._sent: list[tuple[float, tuple[float, ...]]] = []  # when it is to be reached, and what
        try:
            self._await_robot()
        except SettingsError:
            self.close()
            raise
        self._zero_s = self._row_s = self._clock.now_s
        self._take()

    def _describe(self) -> None:
        settings, ros = self._settings, self._settings.ros
        self.target, self.step_s = settings.target, settings.step_s
        self.steps_per_command = round(settings.period_s / settings.step_s)
        self.end_effector, self.cameras = settings.end_effector, tuple(ros.cameras)
        self.tcp_m, self.width_max_m = ros.tool.position_m, settings.width_max_m
        self.gripper_force_n = settings.finger_force_n
        given = [ros.joints[name] for name in settings.joints]
        self.joints = [
            Joint(name, each.low, each.high, velocity, each.axis, each.anchor_m, each.slides)
            for name, each, velocity in zip(settings.joints, given, settings.velocity, strict=True)
        ]
        if ros.gripper is not None:
            self.observations = ("joint_state", "gripper_width")
            self.actions = ("joint_position", "gripper_width")
        if ros.wrench is not None:
            self.observations = (*self.observations, WRENCH)
        if ros.cameras:
            self.observations = (*self.observations, "entity_poses", "camera_rgb", "camera_depth")

    def _open_senders(self) -> None:
        ros, fingers = self._settings.ros, list[Sender]()
        controller, gripper = ros.controller, ros.gripper
        if gripper is not None and gripper.topic:
            fingers.append(ForwardSender(self._node, gripper.topic))
        elif gripper is not None and gripper.action:
            effort = self._settings.finger_force_n / (gripper.force_per_effort or 1.0)
            fingers.append(GripperSender(self._node, gripper, effort))
        self._finger_sender = fingers[0] if fingers else None
        names = [*self._names, *([] if fingers else self._fingers)]
        self._sender: Sender = (
            TrajectorySender(self._node, controller, names, self._clock)
            if controller.kind == "trajectory"
            else ForwardSender(self._node, controller.topic)
        )
        self._senders = [self._sender, *fingers]
        self._watch = None
        if ros.controller_manager:
            claims = {self._sender.controller: names, **{each.controller: self._fingers for each in fingers}}
            self._watch = ControllerWatch(self._node, ros.controller_manager, claims)

    def _open_stop(self) -> None:
        stop = self._settings.ros.stop
        self._stop_client = self._node.create_client(Trigger, stop.service) if stop.service else None
        self._stop_publisher = self._node.create_publisher(Bool, stop.topic, 1) if stop.topic else None

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def _await_robot(self) -> None:
        """Whether all is there that is needed to move and to stop it."""
        wanted: dict[str, Callable[[], object]] = {"/clock": lambda: self._clock.is_running}
        wanted |= {each.name: each.is_heard for each in self._senders}
        if (stop := self._stop_publisher) is not None:
            wanted[stop.topic_name] = lambda: bool(stop.get_subscription_count())
        if self._stop_client is not None:
            wanted[self._node.resolve_service_name(self._settings.ros.stop.service)] = (
                self._stop_client.service_is_ready
            )
        wanted |= self._cameras.list_needs()
        end_s = time.monotonic() + self._settings.ros.wait_s
        for name, is_there in wanted.items():
            while not is_there():
                self._sleep_until(end_s, f"nothing at {name}")
        while True:
            try:
                self._measure([*self._names, *self._fingers])
                return
            except Refusal as refusal:
                self._sleep_until(end_s, str(refusal))

    def _sleep_until(self, end_s: float, found: str) -> None:
        if time.monotonic() > end_s:
            expected = f"it within wait_s: {self._settings.ros.wait_s:g} s; see `ros2 topic list`, `ros2 node list`"
            raise SettingsError(FILE, found, expected)
        time.sleep(LOOK_S)

    @property
    def time_s(self) -> float:
        """The present, in whole steps since the latest row: rows and what is reported between them are evenly apart."""
        return self._row_s + self._count_steps() * self.step_s - self._zero_s

    def _count_steps(self) -> int:
        return math.floor((self._clock.now_s - self._row_s) / self.step_s + SLACK)

    def measure_silence(self, silent_s: float) -> float:
        return self._clock.now_s - self._row_s - self.step_s if self._clock.is_simulated else silent_s

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        """An episode begins where the robot stands; nothing moves."""
        if snapshot:
            raise Refusal("MALFORMED", "a real robot cannot be put into the state of a snapshot")
        self._take()

    def read(self) -> State:
        measured = self._measure([*self._names, *self._fingers])
        arm, fingers = measured[: len(self._names)], measured[len(self._names) :]
        q, qd = [each.q for each in arm], [each.qd for each in arm]
        pose, gripper, width_m, force_n = self._chain.locate(q), self._settings.ros.gripper, 0.0, None
        if gripper is not None:
            way = gripper.opened - gripper.closed
            mean = sum(each.q for each in fingers) / len(fingers)
            width_m = min(max((mean - gripper.closed) / way, 0.0), 1.0) * self.width_max_m
            if gripper.force_per_effort:
                speed_m_s = max(abs(each.qd / way) for each in fingers) * self.width_max_m
                effort = sum(each.effort for each in fingers)
                if not math.isfinite(effort):
                    raise Refusal("TARGET_LOST", f"{self._reader.topic}: no effort of {self._fingers[0]!r}")
                force_n = 0.0 if speed_m_s > MOVING_M_S else max(gripper.force_per_effort * effort, 0.0)
        x, y, z = pose[:3, 3].tolist()
        return State(q, qd, (x, y, z), to_quaternion(pose[:3, :3]), width_m=width_m, grip_force_n=force_n)

    def _measure(self, names: Sequence[str]) -> list[Measured]:
        """Joints by their names in ROS; raises `Refusal` `TARGET_LOST`, also for what takes no set-points any more."""
        complaints = [*(each.complaint for each in self._senders), self._watch.complaint if self._watch else ""]
        for complaint in filter(None, complaints):
            raise Refusal("TARGET_LOST", complaint)
        if self._wrench is not None:
            self._wrench.read()
        return self._reader.read(names)

    def list_signals(self) -> Mapping[str, Sequence[float]]:
        """`wrench`, (6,): forces [N] and torques [N m] in the frame of their sensor, where there is one."""
        return {WRENCH: self._wrench.read()} if self._wrench is not None else {}

    def _locate_tool(self, moment_s: float) -> Array:
        return self._chain.locate(self._reader.read_past(self._names, moment_s))

    def measure_error(self, wanted: Sequence[float]) -> float:
        """Against what is to be reached by now, of what was sent."""
        due = [q for moment_s, q in self._sent if moment_s <= self._clock.now_s]
        return super().measure_error(due[-1] if due else self.read().q)

    def step(self, q: Sequence[float], qd: Sequence[float], width_m: float) -> str:
        self._clock.is_watched = True
        self._await_step()
        self._measure(self._names)  # what is not seen is not moved
        self._q, self._qd, self._wanted_m = tuple(q), tuple(qd), width_m
        self._send()
        return ""

    def call(self, procedure: str, goal: Mapping[str, Any]) -> Call:
        return self._procedures.call(procedure, goal)

    def stay(self) -> None:
        self._await_step()
        if self._width_m != self._wanted_m:
            self._send()

    def _await_step(self) -> None:
        """Until the next whole step begins."""
        start_s = self._row_s + (self._count_steps() + 1) * self.step_s
        self._clock.wait_until(start_s)
        self._row_s = start_s

    def halt(self, category: int) -> None:
        for each in self._senders:
            each.hold()
        if any(self._qd) and isinstance(self._sender, ForwardSender):
            self._ramp_down()
        elif any(self._qd):
            lead_s = self._settings.ros.controller.lead_s
            rest, lasts_s = self._brake()
            self._q, self._qd = tuple(rest), (0.0,) * len(rest)
            self._send(lead_s + lasts_s, is_halting=True)
        self._await_rest()

    def emergency_stop(self) -> None:
        """The robot's own stop first; then the controller is brought to rest as well."""
        if self._stop_client is not None:
            self._stop_client.call_async(Trigger.Request())
        if self._stop_publisher is not None:
            self._stop_publisher.publish(Bool(data=True))
        self.halt(1)

    def note_end(self, session: str) -> None:
        self._clock.complaint, self._clock.is_watched = "", False
        for each in self._senders:
            each.complaint = ""

    def capture(self, cameras: Sequence[str], windows: Mapping[str, Window], every: int) -> Sequence[Picture]:
        return self._cameras.capture(cameras, windows, every, self._zero_s)

    def close(self) -> None:
        self._executor.shutdown(timeout_sec=1.0)
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _take(self) -> None:
        """Set-points go on from where the robot stands."""
        state = self.read()
        self._q, self._qd = tuple(state.q), (0.0,) * len(state.q)
        self._width_m = self._wanted_m = state.width_m

    def _send(self, after_s: float = 0.0, *, is_halting: bool = False) -> None:
        """The present set-point, and where the joints come to rest if no other follows.

        Fingers with a controller of their own are held when the robot halts, and not sent anywhere.
        """
        after_s = after_s or self.step_s + self._settings.ros.controller.lead_s
        fingers, speeds = self._move_fingers()
        if self._finger_sender is not None:
            if not is_halting:
                self._finger_sender.send([Point(fingers, speeds, 0.0)])
            fingers = speeds = ()
        q, qd = (*self._q, *fingers), (*self._qd, *speeds)
        points = [Point(q, qd, after_s)]
        if any(qd):
            rest, lasts_s = self._brake()
            points.append(Point((*rest, *fingers), (0.0,) * len(q), after_s + lasts_s))
        self._sender.send(points)
        self._sent = [*self._sent[-REST_READINGS * 10 :], (self._clock.now_s + after_s, self._q)]

    def _brake(self) -> tuple[list[float], float]:
        rest, lasts_s = brake(self._q, self._qd, self._settings.acceleration)
        pairs = zip(rest, self.joints, strict=True)
        return [min(max(each, joint.low), joint.high) for each, joint in pairs], max(lasts_s, self.step_s)

    def _ramp_down(self) -> None:
        """Positions of a braking motion, one a step, for a controller that takes no trajectory."""
        start, speeds, (_, lasts_s), passed_s = self._q, self._qd, self._brake(), 0.0
        while passed_s < lasts_s:
            passed_s = min(passed_s + self.step_s, lasts_s)
            way_s = passed_s - 0.5 * passed_s**2 / lasts_s
            rows = zip(start, speeds, self.joints, strict=True)
            self._q = tuple(min(max(q + way_s * qd, each.low), each.high) for q, qd, each in rows)
            self._qd = (0.0,) * len(start)
            self._send(is_halting=True)
            try:
                self._clock.wait_until(self._clock.now_s + self.step_s)
            except Refusal:
                return

    def _await_rest(self) -> None:
        """Until the joints stand in several readings; not for a robot that is lost."""
        still, end_s = 0, self._clock.now_s + HALT_MAX_S
        try:
            while still < REST_READINGS and self._clock.now_s < end_s:
                still = still + 1 if max(map(abs, self.read().qd)) < REST else 0
                self._clock.wait_until(self._clock.now_s + self.step_s)
            self._take_posture()
        except Refusal:
            self._qd = (0.0,) * len(self._q)

    def _take_posture(self) -> None:
        width_m, wanted_m = self._width_m, self._wanted_m
        self._take()
        self._width_m, self._wanted_m = width_m, wanted_m

    def _move_fingers(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Their next positions and velocities on the way to the wanted opening, at the speed of the profile."""
        gripper = self._settings.ros.gripper
        if gripper is None or not self.width_max_m:
            return (), ()
        way_m, before_m = self._settings.finger_speed_m_s * self.step_s, self._width_m
        self._width_m += min(max(self._wanted_m - before_m, -way_m), way_m)
        per_m = (gripper.opened - gripper.closed) / self.width_max_m
        n, speed = len(gripper.joints), (self._width_m - before_m) * per_m / self.step_s
        width_m = self._wanted_m if gripper.action else self._width_m  # an action moves by itself
        return (gripper.closed + width_m * per_m,) * n, (speed,) * n
