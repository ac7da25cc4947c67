"""A node with a robot's topics before MuJoCo; run by the Python of a ROS environment.

    python emulator.py FOLDER OPTIONS      # OPTIONS in JSON; FOLDER is written by `cell.py`

Lines on standard input act on the world as a person or a fault would, or ask for its truth; each is answered by a line
of JSON. The world runs no faster than `pace` times real time, and waits for its cameras.
"""

import array
import json
import pickle
import queue
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path

import mujoco
import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

sys.path.insert(0, str(Path(__file__).parent))
from trajectory_controller import TrajectoryController

BEGIN_S = 1000.0  # of the robot's clock
CONTROL_STEPS, REPORT_STEPS, TF_STEPS = 2, 4, 20  # physics steps of 2 ms: 250 Hz, 125 Hz, 25 Hz
CAMERAS_BEHIND_S = 0.06
HABITS = {
    "speeds": "measured",  # or `nan`, or none
    "states_every": 1,  # reports
    "extra": [],  # joints of other machines
    "late_s": 0.0,  # states are sent so much later than their stamp
    "best_effort": False,  # states
    "lens": "repeated",  # or `latched`: once, without coefficients of a distortion
}
KINDS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2, 0], "bgra8": [2, 1, 0, 0]}


def as_bytes(values):
    """What a message takes without a look at each byte."""
    return array.array("B", values.tobytes())


class Plant:
    """The world, as a compiled model and its state."""

    def __init__(self, folder, seed):
        self.about = json.loads((folder / "plant.json").read_text())
        self.model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
        self.data = mujoco.MjData(self.model)
        for name, value in np.load(folder / "state.npz").items():
            getattr(self.data, name)[:] = value
        self.data.time = 0.0
        mujoco.mj_forward(self.model, self.data)
        self.joints, self.fingers = self.about["joints"], self.about["fingers"]
        every = [self.model.joint(name) for name in (*self.joints, *self.fingers)]
        self.q_at, self.v_at = [each.qposadr[0] for each in every], [each.dofadr[0] for each in every]
        self._servos = [self.model.actuator(name).id for name in self.about["servos"]]
        self._drive = self.model.actuator(self.about["drive"]).id
        self._lead_s, self._rng = np.array(self.about["lead_s"]), np.random.default_rng(seed)

    def measure(self):
        """(n,) positions and velocities of arm and fingers, with the noise of encoders."""
        noise = self._rng.normal(size=(2, len(self.q_at))) * [[self.about["noise"][0]], [self.about["noise"][1]]]
        return self.data.qpos[self.q_at] + noise[0], self.data.qvel[self.v_at] + noise[1]

    def servo(self, q, qd):
        n = len(self.joints)
        self.data.ctrl[self._servos] = q[:n] + self._lead_s * qd[:n]
        self.data.ctrl[self._drive] = sum(q[n:])

    @property
    def finger_force(self):
        return -float(self.data.actuator_force[self._drive])

    def find_bodies(self):
        return {name: self.data.body(name).xpos.tolist() for name in self.about["bodies"]}


class Robot(Node):
    def __init__(self, plant, options):
        super().__init__("robot", namespace=options["namespace"])
        self.plant, self.options, self.habits = plant, options, HABITS | options["habits"]
        self.names, q = [options["prefix"] + name for name in (*plant.joints, *plant.fingers)], plant.measure()[0]
        n = len(plant.joints) if options["hand"] else len(q)
        self.controller = TrajectoryController(self.names[:n], q[:n], **options["controller"])
        self.fingers = q[n:]
        self.is_stopped, self.is_silent, self.shift_s, self.poison = False, False, 0.0, None
        self.stopped_at_s, self.stops, self.late_s = None, 0, []
        self._rng = np.random.default_rng(7)
        self._clock_topic = self.create_publisher(Clock, "/clock", 1)
        quality = ReliabilityPolicy.BEST_EFFORT if self.habits["best_effort"] else ReliabilityPolicy.RELIABLE
        self._states = self.create_publisher(JointState, "joint_states", QoSProfile(depth=10, reliability=quality))
        self._wrench = self.create_publisher(WrenchStamped, "wrist/wrench", 1)
        self.wrench = [1.0, -2.0, 9.5, 0.1, 0.0, -0.3]  # N, N m
        self._late = deque()  # when a message of states is to be sent, and the message
        if options["kind"] == "trajectory":
            self.create_subscription(JointTrajectory, "arm_controller/joint_trajectory", self.take, 10)
        else:
            self.create_subscription(Float64MultiArray, "arm_controller/commands", self.forward, 10)
        self.manager = self.gripper = self.frames = None
        if options["ros2_control"] is not None:
            self.add_ros2_control(**options["ros2_control"])
        elif options["hand"]:
            self.create_subscription(Float64MultiArray, "hand_controller/commands", self.move_hand, 10)
        self.create_service(Trigger, "stop", self.stop)
        self.create_subscription(Bool, "stop", self.stop, 1)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        lens = latched if self.habits["lens"] == "latched" else 2
        self.views = {
            name: (
                self.create_publisher(self.find_kind(topics["color"]), topics["color"], 2),
                self.create_publisher(self.find_kind(topics["depth"]), topics["depth"], 2),
                self.create_publisher(CameraInfo, f"{name}/camera_info", lens),
            )
            for name, (_color, _depth, topics) in options["cameras"].items()
        }
        self.has_lens = set()

    def add_ros2_control(self, gripper, frames, tf):
        import ros2_control

        n = len(self.controller.joints)
        claims = {"arm_controller": self.names[:n], "hand_controller": self.names[n:]}
        self.manager = ros2_control.ControllerManager(self, claims)
        self.gripper = ros2_control.GripperAction(self, gripper, (0.0, self.plant.about["opened_m"]))
        self.frames = ros2_control.Frames(self, frames, self.stamp, tf)

    @property
    def is_idle(self):
        return self.is_stopped or (self.manager is not None and self.manager.states["arm_controller"] != "active")

    @staticmethod
    def find_kind(topic):
        return CompressedImage if "/compressed" in topic else Image

    @property
    def now_s(self):
        return BEGIN_S + self.plant.data.time + self.shift_s

    def take(self, message):
        if self.is_idle:
            return
        at_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if at_s:
            self.late_s.append(self.now_s - at_s)
        points = [
            (each.time_from_start.sec + 1e-9 * each.time_from_start.nanosec, each.positions, each.velocities)
            for each in message.points
        ]
        self.controller.take(message.joint_names, points, at_s, self.now_s, self.measure())

    def measure(self):
        return [each[: len(self.controller.joints)] for each in self.plant.measure()]

    def move_hand(self, message):
        if not self.is_stopped:
            self.fingers = np.array(message.data)

    def drive(self):
        q, qd = self.controller.update(self.now_s, self.measure())
        if self.gripper is not None:
            n, dt = len(q), self.plant.model.opt.timestep * CONTROL_STEPS
            self.gripper.update(*(each[n:] for each in self.plant.measure()), dt)
        self.plant.servo(np.append(q, self.fingers), np.append(qd, np.zeros(len(self.fingers))))

    def forward(self, message):
        if not self.is_stopped:
            self.controller.counts["taken"] += 1
            self.controller.desired = np.array(message.data)

    def stop(self, request, reply=None):
        self.is_stopped, self.stops = True, self.stops + 1
        self.stopped_at_s = self.now_s
        self.controller.hold()
        if reply is not None:
            reply.success = True
        return reply

    def stamp(self, moment_s):
        message = Clock().clock
        message.sec, message.nanosec = int(moment_s), int((moment_s - int(moment_s)) * 1e9)
        return message

    def tick(self):
        self._clock_topic.publish(Clock(clock=self.stamp(self.now_s)))

    def report(self):
        if self.is_silent:
            return
        if self.wrench:
            made = WrenchStamped()
            made.header.stamp, of = self.stamp(self.now_s), made.wrench
            of.force.x, of.force.y, of.force.z, of.torque.x, of.torque.y, of.torque.z = self.wrench
            self._wrench.publish(made)
        (q, qd), n = self.plant.measure(), len(self.plant.joints)
        if self.poison is not None:
            q[self.poison] = np.nan
        effort = np.zeros(len(q))
        effort[n:] = self.plant.finger_force / (len(q) - n)
        extra, nothing = self.habits["extra"], np.zeros(len(self.habits["extra"]))
        names, rows = [*extra, *self.names], [np.append(nothing, each) for each in (q, qd, effort)]
        order = self._rng.permutation(len(names))
        message = JointState(name=[names[each] for each in order])
        message.header.stamp = self.stamp(self.now_s)
        message.position, message.velocity, message.effort = (each[order] for each in rows)
        if self.habits["speeds"] != "measured":
            message.velocity = np.full(len(order), np.nan) if self.habits["speeds"] == "nan" else []
        self._late.append((self.now_s + self.habits["late_s"], message))
        while self._late and self._late[0][0] <= self.now_s:
            self._states.publish(self._late.popleft()[1])

    def tell_frames(self):
        quaternion, tool = np.zeros(4), self.plant.data.site(self.plant.about["tcp"])
        mujoco.mju_mat2Quat(quaternion, tool.xmat)
        self.frames.tell(self.now_s, tool.xpos, quaternion)

    def show(self, name, moment_s, rgb, depth_m, lens):
        color_topic, depth_topic, info_topic = self.views[name]
        head = self.stamp(BEGIN_S + moment_s + self.shift_s)
        color, depth, _topics = self.options["cameras"][name]
        height, width = depth_m.shape
        size = {"height": height, "width": width}
        made = [(color_topic, encode_color(rgb, color, size)), (depth_topic, encode_depth(depth_m, depth, size))]
        if self.habits["lens"] == "repeated":
            made.insert(0, (info_topic, CameraInfo(k=lens, d=[0.0] * 5, **size)))
        elif name not in self.has_lens:
            self.has_lens.add(name)
            made.insert(0, (info_topic, CameraInfo(k=lens, **size)))
        for topic, message in made:
            message.header.stamp, message.header.frame_id = head, f"{name}_optical_frame"
            topic.publish(message)


def encode_color(rgb, encoding, size):
    if encoding in KINDS:
        with_alpha = rgb[..., KINDS[encoding]]
        rows = np.ascontiguousarray(with_alpha).reshape(size["height"], -1)
        filled = np.pad(rows, ((0, 0), (0, 8)))  # rows may be longer than pictures are wide
        return Image(encoding=encoding, step=filled.shape[1], data=as_bytes(filled), **size)
    import cv2

    return CompressedImage(
        format=f"rgb8; {encoding} compressed bgr8", data=compress(cv2, f".{encoding}", rgb[..., ::-1])
    )


def compress(cv2, kind, picture):
    return as_bytes(cv2.imencode(kind, np.ascontiguousarray(picture))[1])


def encode_depth(depth_m, encoding, size):
    kind, _, transport = encoding.partition("/")
    raw, header = depth_m.astype("<f4"), bytes(12)
    if kind == "16UC1":
        raw = np.nan_to_num(depth_m * 1000.0).round().astype("<u2")
    elif transport:  # of the inverse, as compressed_depth_image_transport does
        a, b = 100.0 * 101.0, 1.0 - 101.0 * 100.0 / 10.0
        raw, header = np.nan_to_num(a / depth_m + b).round().astype("<u2"), struct.pack("<iff", 0, a, b)
    if not transport:
        return Image(encoding=kind, step=raw.itemsize * size["width"], data=as_bytes(raw), **size)
    import cv2

    made = CompressedImage(format=f"{kind}; compressedDepth png")
    made.data = array.array("B", header) + compress(cv2, ".png", raw)
    return made


class Eyes:
    """Pictures of the world, drawn by another process; the world waits where they are late."""

    def __init__(self, command, folder):
        self._process = subprocess.Popen([*command, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._asked, self.drawn = queue.Queue(), queue.Queue()
        self.pending = []
        threading.Thread(target=self._run, daemon=True).start()

    def ask(self, moment_s, qpos):
        self.pending.append(moment_s)
        self._asked.put((moment_s, qpos.copy()))

    def _run(self):
        while True:
            moment_s, qpos = self._asked.get()
            pickle.dump((moment_s, qpos), self._process.stdin)
            self._process.stdin.flush()
            self.drawn.put((moment_s, pickle.load(self._process.stdout)))


class World:
    def __init__(self, folder, options):
        self.options, self.plant = options, Plant(folder, options["seed"])
        rclpy.init()
        self.robot = Robot(self.plant, options)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.robot)
        self.eyes = Eyes(options["eyes"], folder) if options["cameras"] else None
        if self.eyes is not None:  # it compiles before time begins
            self.eyes.ask(0.0, self.plant.data.qpos)
            self.eyes.drawn.get()
            self.eyes.pending.clear()
        self.orders, self.began_s = queue.Queue(), time.monotonic()
        threading.Thread(target=lambda: [self.orders.put(line) for line in sys.stdin] and None, daemon=True).start()

    def answer(self, order):
        word, *rest = order.split()
        robot = self.robot
        if word == "silent":
            robot.is_silent = rest != ["off"]
        elif word == "nan":
            robot.poison = int(rest[0]) if rest else None
        elif word == "numb":
            robot.wrench = []
        elif word == "jump":
            robot.shift_s += float(rest[0])
        elif word == "reset":
            robot.is_stopped = False
        elif word in {"active", "inactive"}:
            robot.manager.states[rest[0]] = word
            robot.controller.hold()
        late = sorted(robot.late_s) or [0.0]
        n = len(self.plant.joints)
        return {
            "time_s": robot.now_s, "factor": self.plant.data.time / (time.monotonic() - self.began_s),
            "bodies": self.plant.find_bodies(), "counts": dict(robot.controller.counts), "stops": robot.stops,
            "stopped_at_s": robot.stopped_at_s, "speed": float(np.abs(self.plant.data.qvel[self.plant.v_at[:n]]).max()),
            "late_ms": [1e3 * late[int(share * (len(late) - 1))] for share in (0.5, 0.95, 1.0)], "messages": len(late),
            "goals": robot.gripper and [robot.gripper.goals, robot.gripper.rejected],
            "fingers_m": self.plant.measure()[0][n:].tolist(),
            "finite": bool(np.isfinite(self.plant.data.qpos).all()),
        }  # fmt: skip

    def run(self):
        count, due_s = 0, time.monotonic()
        dt = self.plant.model.opt.timestep * CONTROL_STEPS
        rate = round(1.0 / self.options["camera_hz"] / dt) if self.eyes else 0
        while rclpy.ok():
            robot, plant = self.robot, self.plant
            robot.drive()
            mujoco.mj_step(plant.model, plant.data, CONTROL_STEPS)
            count += 1
            robot.tick()
            if count % (REPORT_STEPS // CONTROL_STEPS * robot.habits["states_every"]) == 0:
                robot.report()
            if robot.frames is not None and count % (TF_STEPS // CONTROL_STEPS) == 0:
                robot.tell_frames()
            if self.eyes is not None:
                if count % rate == 0:
                    self.eyes.ask(plant.data.time, plant.data.qpos)
                self.look()
            while not self.orders.empty():
                order = self.orders.get()
                print(json.dumps(self.answer(order)), flush=True)
            due_s = max(due_s + dt / self.options["pace"], time.monotonic() - 0.05)
            self.executor.spin_once(timeout_sec=0)
            while (left_s := due_s - time.monotonic()) > 0.0:
                self.executor.spin_once(timeout_sec=left_s)

    def look(self):
        """Publish what is drawn; time stands while the oldest pictures are too late."""
        while self.eyes.pending:
            is_late = self.plant.data.time - self.eyes.pending[0] > CAMERAS_BEHIND_S
            try:
                moment_s, pictures = (
                    self.eyes.drawn.get(timeout=2.0 if is_late else 0.0) if is_late else self.eyes.drawn.get_nowait()
                )
            except queue.Empty:
                return
            self.eyes.pending.pop(0)
            for name, picture in pictures.items():
                self.robot.show(name, moment_s, *picture)


if __name__ == "__main__":
    World(Path(sys.argv[1]), json.loads(sys.argv[2])).run()
