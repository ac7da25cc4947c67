"""RGB-D cameras: colours and depth of one moment, as arrays, in the place of that moment."""

import struct
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from target_server.body import Picture, Window
from target_server.exposure import Exposure
from target_server.kinematics import Array, make_pose
from target_server.wire import Refusal

from ros2_body.clock import RosClock
from ros2_body.settings import Camera, Ros
from ros2_body.transforms import Transforms

KEPT = 8  # pictures of each kind that wait for the other
MM = 0.001
_CHANNELS = {"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0))}
_DEPTHS = {"16UC1": ("u2", MM), "mono16": ("u2", MM), "32FC1": ("f4", 1.0)}
_HEADER = struct.Struct("<iff")  # of compressed_depth_image_transport: a format, and two coefficients
Pair = tuple[float, float]
HALF_PX = 0.5  # ROS counts from the middle of the first pixel, phyagentos from its corner


@dataclass(frozen=True)
class Shot:
    """Messages of one exposure, and its moment on the robot's clock [s]."""

    at_s: float
    color: Any
    depth: Any
    info: CameraInfo

    @property
    def frame(self) -> str:
        """Its optical frame in TF."""
        return str(self.depth.header.frame_id)

    def develop(self, name: str, time_s: float, pose: Array, window: "Window | None", every: int) -> Picture:
        """The picture, or a part of it, from `world_T_camera` (4, 4)."""
        rgb, raw, unit_m = _read_colors(self.color), *_read_depth(self.depth)
        if rgb.shape[:2] != raw.shape:
            raise Refusal(
                "OBSERVATION_UNAVAILABLE", f"{name}: colours {rgb.shape[:2]} and depth {raw.shape}: not registered"
            )
        return Exposure(name, time_s, rgb, raw, unit_m, *self._read_lens(name, raw.shape)).develop(pose, window, every)

    def _read_lens(self, name: str, shape: tuple[int, ...]) -> tuple[Pair, Pair]:
        """Focal lengths and principal point [px]; raises `Refusal` where it is not that of the pictures."""
        info = self.info
        lens = info.p if info.p[0] else (*info.k[:3], 0.0, *info.k[3:6], 0.0)
        if (
            (info.height, info.width) != shape
            or max(info.binning_x, info.binning_y) > 1
            or not min(lens[0], lens[5]) > 0
        ):
            found = f"focal lengths {lens[0]:g} and {lens[5]:g}, for {info.width} x {info.height} pixels"
            raise Refusal("OBSERVATION_UNAVAILABLE", f"{name}: its CameraInfo is not that of its pictures: {found}")
        return (float(lens[0]), float(lens[5])), (float(lens[2]) + HALF_PX, float(lens[6]) + HALF_PX)


class Cameras:
    """All cameras, each in its place: in the world, on the tool, or where TF has its frame.

    Args:
        locate_tool: `world_T_tool` (4, 4) at a moment of the robot's clock [s].
    """

    def __init__(self, node: Node, ros: Ros, clock: RosClock, locate_tool: Callable[[float], Array]) -> None:
        self._settings, self._ros, self._locate_tool = ros.cameras, ros, locate_tool
        self._cameras = {name: RosCamera(node, each, clock) for name, each in ros.cameras.items()}
        by_tf = [name for name, each in ros.cameras.items() if each.position_m is None]
        self._transforms = Transforms(node, ros.tf, clock) if by_tf else None

    def list_needs(self) -> dict[str, Callable[[], object]]:
        """What is to be there at the start, and whether it is."""
        needs: dict[str, Callable[[], object]] = {}
        for name, camera in self._cameras.items():
            needs[f"the topics of camera {name!r}"] = camera.list_shots
            if self._settings[name].position_m is None:
                says = f"{self._ros.tf} from {self._ros.world!r} to the frame of the pictures of camera {name!r}"
                needs[says] = partial(self._find_latest, name)
        return needs

    def capture(
        self, names: Sequence[str], windows: Mapping[str, Window], every: int, zero_s: float
    ) -> Sequence[Picture]:
        """As `Body.capture`; `zero_s` is where the body's time begins on the robot's clock [s]."""
        unknown = [name for name in (*names, *windows) if name not in self._cameras]
        if unknown:
            known = ", ".join(self._cameras) or "none"
            raise Refusal("REQUEST_INVALID", f"no camera {unknown[0]!r}; there are {known}")
        found = [(name, each) for name in names or self._cameras if (each := self._find_latest(name)) is not None]
        return [shot.develop(name, shot.at_s - zero_s, pose, windows.get(name), every) for name, (shot, pose) in found]

    def _find_latest(self, name: str) -> "tuple[Shot, Array] | None":
        """The latest exposure whose place is known, and `world_T_camera`."""
        for shot in self._cameras[name].list_shots():
            if (pose := self._place(name, shot)) is not None:
                return shot, pose
        return None

    def _place(self, name: str, shot: Shot) -> "Array | None":
        camera = self._settings[name]
        if camera.position_m is None or camera.quaternion_wxyz is None:
            assert self._transforms is not None
            return self._transforms.locate(self._ros.world, shot.frame, shot.at_s)
        pose = make_pose(camera.position_m, camera.quaternion_wxyz)
        return self._locate_tool(shot.at_s) @ pose if camera.on_tool else pose


class RosCamera:
    """The topics of one camera."""

    def __init__(self, node: Node, settings: Camera, clock: RosClock) -> None:
        self._node, self._settings = node, settings
        self._clock, self._lock = clock, threading.Lock()
        self._colors: deque[tuple[float, Any]] = deque(maxlen=KEPT)
        self._depths: deque[tuple[float, Any]] = deque(maxlen=KEPT)
        self._info: CameraInfo | None = None
        reliability = ReliabilityPolicy.RELIABLE if settings.reliable else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=2, reliability=reliability)
        for topic, kept in ((settings.color, self._colors), (settings.depth, self._depths)):
            kind = CompressedImage if "/compressed" in topic else Image
            node.create_subscription(kind, topic, partial(self._take, kept), qos)
        node.create_subscription(CameraInfo, settings.info, self._take_info, qos)
        self._hears_latched = False

    def list_shots(self) -> list[Shot]:
        """Exposures of which both pictures are there, the latest first."""
        if (info := self._info) is None:
            self._hear_latched()
            return []
        with self._lock:
            return [
                Shot(at_s, color, depth, info)
                for at_s, depth in reversed(self._depths)
                for color_s, color in reversed(self._colors)
                if abs(color_s - at_s) <= self._settings.together_s
            ]

    def _hear_latched(self) -> None:
        """A lens that was published once, before this node was there."""
        latched, topic = DurabilityPolicy.TRANSIENT_LOCAL, self._node.resolve_topic_name(self._settings.info)
        found = self._node.get_publishers_info_by_topic(topic)
        if not self._hears_latched and any(each.qos_profile.durability == latched for each in found):
            self._hears_latched = True
            self._node.create_subscription(CameraInfo, topic, self._take_info, QoSProfile(depth=1, durability=latched))

    def _take(self, kept: "deque[tuple[float, Any]]", message: Any) -> None:
        with self._lock:
            kept.append((self._clock.read_stamp(message.header.stamp), message))

    def _take_info(self, message: CameraInfo) -> None:
        self._info = message


def _read_colors(message: Any) -> NDArray[np.uint8]:
    """(h, w, 3) red, green and blue; raises `Refusal` for an encoding that is none of these."""
    if isinstance(message, CompressedImage):
        return _decompress(message)
    if message.encoding not in _CHANNELS:
        raise Refusal("OBSERVATION_UNAVAILABLE", f"colours as {message.encoding!r}; known: {', '.join(_CHANNELS)}")
    channels, order = _CHANNELS[message.encoding]
    return _unpack(message, "u1", channels)[..., list(order)]


def _read_depth(message: Any) -> tuple[NDArray[Any], float]:
    """(h, w) numbers, and what one of them is [m]; raises `Refusal`."""
    is_compressed = isinstance(message, CompressedImage)
    encoding = message.format.split(";")[0] if is_compressed else message.encoding
    if encoding not in _DEPTHS:
        raise Refusal("OBSERVATION_UNAVAILABLE", f"depth as {encoding!r}; known: {', '.join(_DEPTHS)}")
    kind, unit_m = _DEPTHS[encoding]
    if is_compressed:
        return _decompress_depth(message, kind), unit_m
    return _unpack(message, f"{'>' if message.is_bigendian else '<'}{kind}", 1)[..., 0], unit_m


def _unpack(message: Image, kind: str, channels: int) -> NDArray[Any]:
    """(h, w, channels) of rows that may be longer than the picture is wide."""
    item = np.dtype(kind)
    data = np.frombuffer(message.data, np.uint8)
    if len(data) < message.step * message.height or message.step < message.width * channels * item.itemsize:
        raise Refusal(
            "OBSERVATION_UNAVAILABLE", f"{len(data)} bytes are no picture of {message.width} x {message.height}"
        )
    rows = data[: message.step * message.height].reshape(message.height, message.step)
    used = np.ascontiguousarray(rows[:, : message.width * channels * item.itemsize])
    return used.view(item).reshape(message.height, message.width, channels)


def _decompress(message: CompressedImage, begin: int = 0, dimensions: int = 3) -> NDArray[Any]:
    """JPEG or PNG from a byte on, by OpenCV, which comes with `cv_bridge`; raises `Refusal`."""
    import cv2

    data, how = np.frombuffer(message.data, np.uint8)[begin:], (cv2.IMREAD_UNCHANGED, cv2.IMREAD_COLOR)
    found = cv2.imdecode(data, how[dimensions == 3]) if len(data) else None
    if found is None or found.ndim != dimensions:
        raise Refusal("OBSERVATION_UNAVAILABLE", f"{len(message.data)} bytes of {message.format!r} are no picture")
    return np.asarray(found[..., ::-1] if dimensions == 3 else found)


def _decompress_depth(message: CompressedImage, kind: str) -> NDArray[Any]:
    """(h, w) of `compressedDepth`: behind a header a PNG of numbers, or of the inverse of fractions."""
    has_header = "compressedDepth" in message.format
    raw = _decompress(message, _HEADER.size if has_header else 0, 2)
    if raw.dtype != np.uint16 or (kind == "f4" and not has_header):
        raise Refusal("OBSERVATION_UNAVAILABLE", f"{raw.dtype} as {message.format!r} is no depth")
    if kind != "f4":
        return raw
    _, a, b = _HEADER.unpack_from(bytes(message.data[: _HEADER.size]))
    return np.where(raw > 0, a / np.maximum(raw - np.float32(b), 1.0), 0.0)
