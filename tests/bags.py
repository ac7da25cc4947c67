"""A recorder of ROS 2 bags that knows nothing of this project but a scene's physics: cameras, joints, transforms.

What it records is rendered by the simulator's cameras with their noise, and written by the package rosbags.
"""

import struct
from dataclasses import dataclass, field
from functools import cache

import cv2
import mujoco
import numpy as np
from scipy.optimize import least_squares

from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state
from phyagentos.runtime.models.robot import read_profile

SCENE = "tabletop/cubes_and_trays"
EPOCH_S = 1_700_000_000.0
_SHOWN = {}  # frames, by all that decides them: most bags begin alike


class Table:
    """The scene with its robot, still; `put` sets an object elsewhere, `where` says where it truly is."""

    def __init__(self, scene=SCENE, seed=3, robot="panda", level="nominal"):
        self.made = (scene, seed, robot, level)
        library = Library.open(find_shipped_root())
        self.profile, folder = read_profile(library.get_target(robot))
        self.physics = Physics.alone(self.profile, folder, read_scene(library.get_scene(scene)), seed)
        self.physics.start(0.5)
        sensors = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")
        self.cameras = open_cameras(self.physics.model, sensors, seed=seed, level=level)

    def where(self, name):
        self.physics.queries.look()
        return np.array(self.physics.queries.seen.xpos[self.physics.model.body(name).id])

    def put(self, name, x_m, y_m, z_m):
        model, data = self.physics.model, self.physics.data
        address = int(model.jnt_qposadr[model.body(name).jntadr[0]])
        data.qpos[address : address + 7] = x_m, y_m, z_m, 1.0, 0.0, 0.0, 0.0

    def put_into(self, name, tray, off_m=(0.0, 0.0, 0.0)):
        x, y, z = self.where(tray) + np.array([0.0, 0.0, 0.0255]) + off_m
        self.put(name, x, y, z)

    def reach(self, at_m, width_m):
        """Stand with the tool pointing down at a place, and the fingers so far apart."""
        model, data = self.physics.model, self.physics.data
        arm = [int(model.joint(name).qposadr[0]) for name in self.profile.arm.joints]
        tool, pose = model.site(self.profile.tcp).id, mujoco.MjData(model)

        def miss(q_rad):
            pose.qpos[:] = data.qpos
            pose.qpos[arm] = q_rad
            mujoco.mj_kinematics(model, pose)
            return [*(pose.site_xpos[tool] - at_m), *(0.3 * (pose.site_xmat[tool].reshape(3, 3)[:, 2] - (0, 0, -1)))]

        data.qpos[arm] = least_squares(miss, data.qpos[arm]).x
        assert np.linalg.norm(miss(data.qpos[arm])) < 1e-3
        for finger in self.profile.gripper.joints:
            data.qpos[int(model.joint(finger).qposadr[0])] = width_m / 2

    def capture(self, camera, time_s, number):
        shown = (*self.made, self.physics.data.qpos.tobytes(), camera, number)
        if shown not in _SHOWN:
            data = pose_state(self.physics.model, self.physics.data.qpos)
            rng = np.random.default_rng((number, sorted(self.cameras).index(camera)))
            _SHOWN[shown] = self.cameras[camera].capture(data, time_s, rng)
        return _SHOWN[shown]

    def joints(self):
        self.physics.queries.look()
        state = self.physics.queries.read_target({})
        half_m = state.gripper_width_m / 2
        return dict(zip(self.profile.arm.joints, state.q_rad, strict=True)) | {
            "left_finger_joint": half_m,
            "right_finger_joint": half_m,
        }


@cache
def _get_types():
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


@dataclass
class Recorder:
    """How a run is recorded, and what goes wrong.

    Attributes:
        drops: (topic, time_s) -> whether that message is lost.
        late_s: (topic, time_s) -> how much later than its stamp a message is recorded [s].
        clock_s: By topic, how far its stamps are from those of the others [s].
        color: `png`, `jpeg`, or an encoding of sensor_msgs/Image; `depth` likewise, with `/compressedDepth` after it as
            image_transport compresses it.
        lens_once_s: Where it is given, lenses are recorded once, then, and without coefficients of a distortion [s].
        static_s: When fixed places are recorded [s].
        extra: Joints that are no part of the robot, recorded before those that are.
        rectified: Whether pictures are of an image_proc, whose lens has the distortion of before too.
        tf: (camera, world_T_camera) -> what is said of it; None for nothing.
    """

    cameras: tuple[str, ...] = ("overhead", "left", "right")
    rate_hz: float = 10.0
    color: str = "rgb8"
    depth: str = "16UC1"
    drops: object = lambda topic, time_s: False
    clock_s: dict = field(default_factory=dict)
    late_s: object = lambda topic, time_s: 0.005
    tf: object = lambda camera, pose: pose
    moving: tuple[str, ...] = ("wrist",)
    joint_names: dict = field(default_factory=dict)
    frozen: tuple[str, ...] = ()
    lens_once_s: float | None = None
    static_s: float = 0.0
    extra: tuple[str, ...] = ()
    rectified: bool = False

    def record(self, table, to, script, until_s=3.0):
        """Record from 0 to `until_s` [s]; `script` maps times to functions that change the table."""
        from rosbags.rosbag2 import StoragePlugin, Writer

        self.store, self.topics, self.once = _get_types(), {}, set()
        self.make = lambda kind, **fields: self.store.types[kind](**fields)
        waiting, last = sorted(script.items()), {}
        with Writer(to, version=8, storage_plugin=StoragePlugin.MCAP) as self.writer:
            for number in range(round(until_s * 50) + 1):
                time_s = number / 50
                while waiting and waiting[0][0] <= time_s:
                    waiting.pop(0)[1](table)
                self.write_joints(table, time_s)
                if number % round(50 / self.rate_hz) == 0:
                    for camera in self.cameras:
                        frame = table.capture(camera, time_s, number)
                        frame = last.setdefault(camera, frame) if camera in self.frozen else frame
                        self.write_frame(camera, frame, time_s)
        return to

    def write(self, topic, kind, time_s, message):
        if not self.drops(topic, time_s):
            if topic not in self.topics:
                self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
            data = self.store.serialize_cdr(message, kind)
            self.writer.write(self.topics[topic], round((EPOCH_S + time_s + self.late_s(topic, time_s)) * 1e9), data)

    def head(self, topic, time_s, frame=""):
        stamp_ns = round((EPOCH_S + time_s + self.clock_s.get(topic, 0.0)) * 1e9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def is_first(self, what, time_s, from_s):
        """Whether a message that is sent once, from a moment on, is sent now."""
        is_now = time_s >= from_s and what not in self.once
        self.once |= {what} if is_now else set()
        return is_now

    def write_joints(self, table, time_s):
        topic, none = "/joint_states", np.zeros(0)
        found = {self.joint_names.get(name, name): value for name, value in table.joints().items()}
        found = dict.fromkeys(self.extra, 0.0) | dict(reversed(found.items()))
        names, position = [*found], np.array([*found.values()])
        kind = "sensor_msgs/msg/JointState"
        fields = {"name": names, "position": position, "velocity": none, "effort": none}
        self.write(topic, kind, time_s, self.make(kind, header=self.head(topic, time_s), **fields))

    def write_frame(self, camera, frame, time_s):
        optical = f"{camera}_optical_frame"
        self.write_place(camera, frame, time_s, optical)
        topic = f"/{camera}/color/{'image_rect_color' if self.rectified else 'image_raw'}"
        if self.color in {"png", "jpeg"}:
            topic, kind = f"{topic}/compressed", "sensor_msgs/msg/CompressedImage"
            data = cv2.imencode(f".{self.color}", np.ascontiguousarray(frame.rgb[..., ::-1]))[1].ravel()
            head = self.head(topic, time_s, optical)
            self.write(topic, kind, time_s, self.make(kind, header=head, format=self.color, data=data))
        else:
            with_alpha = np.dstack((frame.rgb, np.full(frame.rgb.shape[:2], 255, np.uint8)))
            pictures = {
                "rgb8": frame.rgb,
                "bgr8": frame.rgb[..., ::-1],
                "mono8": frame.rgb[..., 0],
                "rgba8": with_alpha,
            }
            self.write_image(topic, self.color, pictures[self.color], time_s, optical)
        self.write_depth(f"/{camera}/depth/image_rect", frame.depth_m, time_s, optical)
        if self.lens_once_s is None or self.is_first(f"{camera} lens", time_s, self.lens_once_s):
            self.write_lens(f"/{camera}/color/camera_info", frame, time_s, optical)

    def write_depth(self, topic, depth_m, time_s, optical):
        encoding, _, transport = self.depth.partition("/")
        raw, header = depth_m, np.zeros(12, np.uint8)
        if encoding == "16UC1":
            raw = np.nan_to_num(np.round(depth_m * 1000)).astype(np.uint16)
        elif transport:  # 32FC1 is quantised in its inverse, as compressed_depth_image_transport does
            a, b = 100.0 * 101.0, 1.0 - 101.0 * 100.0 / 10.0
            header = np.frombuffer(struct.pack("<iff", 0, a, b), np.uint8)
            raw = np.nan_to_num(np.round(a / depth_m + b)).astype(np.uint16)
        if transport:
            kind, png = "sensor_msgs/msg/CompressedImage", cv2.imencode(".png", raw)[1].ravel()
            head, data = self.head(topic, time_s, optical), np.concatenate((header, png))
            made = self.make(kind, header=head, format=f"{encoding}; compressedDepth png", data=data)
            self.write(f"{topic}/{transport}", kind, time_s, made)
        elif encoding:
            self.write_image(topic, encoding, raw, time_s, optical)

    def write_lens(self, topic, frame, time_s, optical):
        kind = "sensor_msgs/msg/CameraInfo"
        k = np.array([frame.fx, 0, frame.cx - 0.5, 0, frame.fy, frame.cy - 0.5, 0, 0, 1.0])
        p, d = np.zeros(12), np.zeros(5 if self.lens_once_s is None else 0)
        if self.rectified:
            p, d = np.insert(k, (3, 6, 9), 0.0), np.full(5, 0.1)
            k = k * 1.1
        roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        lens = {"distortion_model": "plumb_bob", "d": d, "k": k, "r": np.eye(3).ravel(), "p": p}
        size = {"height": frame.height, "width": frame.width, "binning_x": 0, "binning_y": 0}
        roi = self.make("sensor_msgs/msg/RegionOfInterest", **roi)
        head = self.head(topic, time_s, optical)
        self.write(topic, kind, time_s, self.make(kind, header=head, roi=roi, **lens, **size))

    def write_image(self, topic, encoding, picture, time_s, optical):
        kind, size = "sensor_msgs/msg/Image", {"height": picture.shape[0], "width": picture.shape[1]}
        rows = np.ascontiguousarray(picture).view(np.uint8).reshape(picture.shape[0], -1)
        fields = {"encoding": encoding, "is_bigendian": 0, "step": rows.shape[1], "data": rows.ravel()}
        self.write(topic, kind, time_s, self.make(kind, header=self.head(topic, time_s, optical), **fields, **size))

    def write_place(self, camera, frame, time_s, optical):
        topic = "/tf" if camera in self.moving else "/tf_static"
        pose = self.tf(camera, frame.world_T_camera)
        if pose is None or (topic == "/tf_static" and not self.is_first(f"{camera} place", time_s, self.static_s)):
            return
        w, x, y, z = pose.quaternion_wxyz
        place = self.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", pose.position_m, strict=True)))
        turned = self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        step = self.make("geometry_msgs/msg/Transform", translation=place, rotation=turned)
        head, kind = self.head(topic, time_s, "world"), "tf2_msgs/msg/TFMessage"
        named = self.make("geometry_msgs/msg/TransformStamped", header=head, child_frame_id=optical, transform=step)
        self.write(topic, kind, time_s, self.make(kind, transforms=[named]))
