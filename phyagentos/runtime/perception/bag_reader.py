"""A bag of ROS 2 as numbers: joint states, transforms, and pictures with the stamps of their sensors.

Nothing of it is believed here. Upstream: rosbags, which needs no ROS. Downstream: `bag_looks`.
"""

import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError, needs_extra
from phyagentos.geometry import as_pose, make_matrix
from phyagentos.protocol.world.environment import Pose

INFO, JOINTS = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/JointState"
PICTURES, TRANSFORMS = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"), "tf2_msgs/msg/TFMessage"
EDGE_NS = 3_000_000_000  # pictures are read so long after the bag's begin, and so long before its end
_CHANNELS = {"rgb8": (3, [0, 1, 2]), "bgr8": (3, [2, 1, 0]), "rgba8": (4, [0, 1, 2]), "bgra8": (4, [2, 1, 0])}
_DEPTHS: dict[str, tuple[str, float]] = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
_HEADER = struct.Struct("<iff")  # of compressed_depth_image_transport: a format, and two coefficients
Array = NDArray[np.float64]
RosMessage = Any  # rosbags makes its types, and those of its readers, as it runs


class Taken(NamedTuple):
    """A message of a sensor: its own stamp and when it was recorded [ns]; the message of rosbags."""

    stamp_ns: int
    logged_ns: int
    message: RosMessage

    @property
    def frame(self) -> str:
        """The frame of TF in which it is meant."""
        return str(self.message.header.frame_id).strip("/")


@dataclass(frozen=True, slots=True)
class Course:
    """Values (n, k) over stamps (n,) [ns], ascending; `lags_ns` (n,) is how much later each was recorded."""

    stamps_ns: NDArray[np.int64]
    values: Array
    lags_ns: NDArray[np.int64]

    def find(self, stamp_ns: int, gap_ns: int) -> tuple[Array, Array, float] | None:
        """The values around a stamp and how far it is between them, 0..1; None outside, or in a longer gap."""
        after = int(np.searchsorted(self.stamps_ns, stamp_ns))
        before = after - int(stamp_ns not in self.stamps_ns[after : after + 1])
        if before < 0 or after == len(self.stamps_ns):
            return None
        begin_ns, end_ns = self.stamps_ns[[before, after]].tolist()
        share = (stamp_ns - begin_ns) / max(end_ns - begin_ns, 1)
        return (self.values[before], self.values[after], share) if end_ns - begin_ns <= gap_ns else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Bag:
    """What a bag holds.

    Attributes:
        begin_ns: When its first message was recorded, and `end_ns` its last [ns].
        types: Type of each topic.
        pictures: Pictures, depths and lenses by topic, of the first and of the last seconds.
        joints: Positions of each joint by topic and name.
        frames: By name the parent, and `parent_T_frame` as position and quaternion w x y z: (7,) of /tf_static, or a
            course of them. The parent is empty where two are given, or two places in /tf_static.
    """

    begin_ns: int
    end_ns: int
    types: Mapping[str, str]
    pictures: Mapping[str, Sequence[Taken]]
    joints: Mapping[str, Mapping[str, Course]]
    frames: Mapping[str, tuple[str, Array | Course]]

    def find_pose(self, frame: str, world: str, stamp_ns: int, gap_ns: int) -> Pose | str:
        """`world_T_frame` at a stamp, or why there is none."""
        T, at, passed = np.eye(4), frame, {frame}
        while at != world:
            parent, step = self.frames.get(at, ("", np.zeros(7)))
            if not parent or parent in passed:
                return f"no transform leads from {world} to {frame}: {at} has no parent, two, or itself above it"
            found = step.find(stamp_ns, gap_ns) if isinstance(step, Course) else (step, step, 0.0)
            if found is None:
                return f"no transform of {at} within {gap_ns / 1e9:g} s before and after its pictures"
            T, at = _interpolate(*found) @ T, parent
            passed.add(at)
        return as_pose(T[:3, :3], T[:3, 3])


def read_bag(path: Path) -> Bag:
    """Read a bag folder, or an MCAP file.

    Raises:
        DefinitionError: `EXTRA_MISSING`; `UNREADABLE_FILE` where it is missing, truncated, or no bag of ROS 2.
    """
    pictures: dict[str, list[Taken]] = defaultdict(list)
    joints: dict[str, dict[str, list[RosMessage]]] = defaultdict(lambda: defaultdict(list))
    with _reading(path) as reader:
        begin_ns, end_ns = reader.start_time, reader.end_time
        first_ns = begin_ns + EDGE_NS
        for span in ((begin_ns, first_ns), (max(end_ns - EDGE_NS, first_ns), end_ns)):
            for topic, logged_ns, message in _iter_messages(reader, (INFO, *PICTURES), *span):
                pictures[topic].append(Taken(_read_stamp(message.header), logged_ns, message))
        for topic, logged_ns, message in _iter_messages(reader, (INFO,)):
            if topic not in pictures:  # a lens that was published once, between both ends
                pictures[topic].append(Taken(_read_stamp(message.header), logged_ns, message))
        for topic, logged_ns, message in _iter_messages(reader, (JOINTS,)):
            for name, position in zip(message.name, message.position, strict=False):
                joints[topic][name].append((_read_stamp(message.header), logged_ns, [position]))
        frames = _read_frames(reader)
        types = {each.topic: each.msgtype for each in reader.connections}
    courses = {topic: {name: _join(rows) for name, rows in each.items()} for topic, each in joints.items()}
    return Bag(begin_ns=begin_ns, end_ns=end_ns, types=types, pictures=pictures, joints=courses, frames=frames)


def iter_taken(path: Path, topic: str) -> Iterator[Taken]:
    """All pictures of a topic, in the order of their recording; raises as `read_bag`."""
    with _reading(path) as reader:
        for found, logged_ns, message in _iter_messages(reader, PICTURES):
            if found == topic:
                yield Taken(_read_stamp(message.header), logged_ns, message)


@contextmanager
def _reading(path: Path) -> Iterator[RosMessage]:
    with needs_extra("export", "paos verify --bag"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    try:  # a library of many formats raises many errors for damaged bytes
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            if not reader.message_count:
                raise ValueError("it has no message")
            yield reader
    except Exception as error:
        expected = "a bag of ROS 2, a folder with metadata.yaml or an MCAP file"
        hint = "One whose recorder did not end is repaired by `ros2 bag reindex`, or `mcap recover`."
        raise DefinitionError.of("UNREADABLE_FILE", str(path), str(error), expected, hint) from error


def _iter_messages(reader: RosMessage, types: tuple[str, ...], *span: int) -> Iterator[tuple[str, int, RosMessage]]:
    """Messages of these types by topic, each with the time of its recording [ns]."""
    if connections := [each for each in reader.connections if each.msgtype in types]:
        for connection, logged_ns, data in reader.messages(connections, *span):
            yield connection.topic, logged_ns, reader.deserialize(data, connection.msgtype)


def _read_stamp(header: RosMessage) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _join(rows: list[RosMessage]) -> Course:
    """A course of (stamp, recorded, values) in any order, without what is no number; of one stamp the first."""
    finite = [each for each in rows if np.isfinite(each[2]).all()]
    stamps, order = np.unique(np.array([each[0] for each in finite], np.int64), return_index=True)
    lags = np.array([each[1] for each in finite], np.int64)[order] - stamps
    return Course(stamps, np.array([each[2] for each in finite], np.float64)[order], lags)


def _read_frames(reader: RosMessage) -> dict[str, tuple[str, Array | Course]]:
    parents: dict[str, set[str]] = defaultdict(set)
    fixed: dict[str, Array] = {}
    rows: dict[str, list[RosMessage]] = defaultdict(list)
    for topic, logged_ns, message in _iter_messages(reader, (TRANSFORMS,)):
        for each in message.transforms:
            child, place, turned = each.child_frame_id.strip("/"), each.transform.translation, each.transform.rotation
            values = np.array([place.x, place.y, place.z, turned.w, turned.x, turned.y, turned.z])
            if not (np.isfinite(values).all() and values[3:].any()):
                continue
            parents[child].add(each.header.frame_id.strip("/"))
            if not topic.endswith("tf_static"):
                rows[child].append((_read_stamp(each.header), logged_ns, values))
            elif not np.allclose(fixed.setdefault(child, values), values):
                parents[child].add("")
    steps: dict[str, Array | Course] = {**fixed, **{child: _join(each) for child, each in rows.items()}}
    return {child: (next(iter(each)) if len(each) == 1 else "", steps[child]) for child, each in parents.items()}


def _interpolate(a: Array, b: Array, share: float) -> Array:
    """(4, 4) between two transforms (7,); along the shorter turn."""
    from scipy.spatial.transform import Rotation, Slerp

    turns = Rotation.from_quat([a[[4, 5, 6, 3]], b[[4, 5, 6, 3]]])
    return make_matrix(Slerp([0.0, 1.0], turns)(share).as_matrix(), a[:3] + share * (b[:3] - a[:3]))


def find_kind(taken: Taken) -> str:
    """`color` or `depth`; else the encoding of a picture, which is not read."""
    name = _name_encoding(taken.message)
    if name.startswith((*_DEPTHS,)):
        return "depth" if decode_depth(taken) is not None else f"encoding {name!r}"
    return "color" if decode_color(taken) is not None else f"encoding {name!r}"


def _name_encoding(message: RosMessage) -> str:
    return str(getattr(message, "encoding", "") or getattr(message, "format", ""))


def decode_color(taken: Taken) -> NDArray[np.uint8] | None:
    """(height, width, 3), uint8; None where its bytes are no picture in colour."""
    message = taken.message
    if hasattr(message, "format"):
        decoded = cv2.imdecode(np.asarray(message.data), cv2.IMREAD_COLOR) if len(message.data) else None
        return None if decoded is None else np.ascontiguousarray(decoded[..., ::-1])
    channels, order = _CHANNELS.get(message.encoding, (0, []))
    rows = _cut_rows(message, np.dtype(np.uint8), channels)
    return None if rows is None else np.ascontiguousarray(rows.reshape(*rows.shape[:1], -1, channels)[..., order])


def decode_depth(taken: Taken) -> NDArray[np.float32] | None:
    """(height, width) along z [m], NaN where nothing was measured; None where its bytes do not fill it."""
    message = taken.message
    kind, unit_m = _DEPTHS[_name_encoding(message).split(";")[0]]
    if hasattr(message, "format"):
        depth_m = _decompress_depth(message, kind, unit_m)
    else:
        rows = _cut_rows(message, np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<"), 1)
        depth_m = None if rows is None else rows.astype(np.float32) * np.float32(unit_m)
    if depth_m is None:
        return None
    return np.where(np.isfinite(depth_m) & (depth_m > 0.0), depth_m, np.float32(np.nan))


def _decompress_depth(message: RosMessage, kind: str, unit_m: float) -> NDArray[np.float32] | None:
    """Of `compressedDepth`: a header, then a PNG of numbers, or of the inverse of fractions; [m]."""
    data = np.asarray(message.data)
    has_header = "compressedDepth" in message.format and len(data) > _HEADER.size
    data, header = data[_HEADER.size if has_header else 0 :], data[: _HEADER.size].tobytes()
    raw = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    if raw is None or raw.dtype != np.uint16 or raw.ndim != 2 or (kind == "f4" and not has_header):
        return None
    if kind != "f4":
        return raw.astype(np.float32) * np.float32(unit_m)
    _, a, b = _HEADER.unpack(header)
    return np.where(raw > 0, a / np.maximum(raw - np.float32(b), 1.0), 0.0).astype(np.float32)


def _cut_rows(message: RosMessage, kind: np.dtype[np.generic], channels: int) -> NDArray[np.generic] | None:
    """(height, width * channels) without the filling at the ends of rows."""
    data, width = np.asarray(message.data), message.width * channels * kind.itemsize
    if not 0 < width <= message.step or not len(data) == message.step * message.height > 0:
        return None
    return np.ascontiguousarray(data.reshape(message.height, message.step)[:, :width]).view(kind)
