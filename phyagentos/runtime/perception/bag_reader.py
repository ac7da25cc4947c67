"""A bag of ROS 2 as numbers: joint states, transforms, and pictures with the stamps of their sensors.

Nothing of it is believed here. Upstream: rosbags, which needs no ROS. Downstream: `bag_frames`.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError, needs_extra
from phyagentos.geometry import as_pose, make_matrix
from phyagentos.protocol.world.environment import Pose

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO, JOINTS, TRANSFORMS = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage"
EDGE_S = 3.0  # pictures are read so long after the bag's begin, and so long before its end
_CHANNELS = {"rgb8": (3, [0, 1, 2]), "bgr8": (3, [2, 1, 0]), "rgba8": (4, [0, 1, 2]), "bgra8": (4, [2, 1, 0])}
_DEPTHS: dict[str, tuple[str, float]] = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Taken:
    """A message of a sensor: its own stamp and when it was recorded [ns]; the message of rosbags."""

    stamp_ns: int
    logged_ns: int
    message: Any


@dataclass(frozen=True, slots=True)
class Course:
    """Values (n, k) over stamps (n,) [ns], ascending; `lags_ns` (n,) is how much later each was recorded."""

    stamps_ns: NDArray[np.int64]
    values: Array
    lags_ns: NDArray[np.int64]

    def find(self, stamp_ns: int, gap_ns: int) -> tuple[Array, Array, float] | None:
        """The values around a stamp and how far it is between them, 0..1; None outside, or in a longer gap."""
        after = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if after < len(self.stamps_ns) and self.stamps_ns[after] == stamp_ns:
            return self.values[after], self.values[after], 0.0
        if not 0 < after < len(self.stamps_ns):
            return None
        begin_ns, end_ns = int(self.stamps_ns[after - 1]), int(self.stamps_ns[after])
        if end_ns - begin_ns > gap_ns:
            return None
        return self.values[after - 1], self.values[after], (stamp_ns - begin_ns) / (end_ns - begin_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bag:
    """What a bag holds.

    Attributes:
        begin_ns: When its first message was recorded, and `end_ns` its last [ns].
        types: Type of each topic.
        images: Pictures and depths by topic, of the first and of the last seconds.
        infos: Lenses by topic, likewise.
        joints: Positions of each joint by topic and name.
        fixed: Frames of /tf_static: parent, and `parent_T_child`; `moving`, of /tf, has one course (n, 7) a child.
        conflicts: Frames with two parents, or with two places in /tf_static.
    """

    begin_ns: int
    end_ns: int
    types: Mapping[str, str]
    images: Mapping[str, Sequence[Taken]]
    infos: Mapping[str, Sequence[Taken]]
    joints: Mapping[str, Mapping[str, Course]]
    fixed: Mapping[str, tuple[str, Array]]
    moving: Mapping[str, tuple[str, Course]]
    conflicts: frozenset[str]

    def find_pose(self, frame: str, world: str, stamp_ns: int, gap_ns: int) -> Pose | str:
        """`world_T_frame` at a stamp, or why there is none."""
        T, at, passed = np.eye(4), frame, {frame}
        while at != world:
            if at in self.conflicts:
                return f"the frame {at} has two parents, or two places in /tf_static"
            if at in self.moving:
                parent, course = self.moving[at]
                if (found := course.find(stamp_ns, gap_ns)) is None:
                    return f"no transform of {at} within {gap_ns / 1e9:g} s before and after its pictures"
                step = _interpolate(*found)
            elif at in self.fixed:
                parent, step = self.fixed[at]
            else:
                return f"no transform leads from {world} to {frame}: {at} has no parent"
            if parent in passed:
                return f"the transforms of {frame} go in a circle"
            T, at = step @ T, parent
            passed.add(at)
        return as_pose(T[:3, :3], T[:3, 3])


def read_bag(path: Path) -> Bag:
    """Read a bag folder, or an MCAP file.

    Raises:
        DefinitionError: `EXTRA_MISSING`; `UNREADABLE_FILE` where it is missing, truncated, or no bag of ROS 2.
    """
    with _reading(path) as reader:
        types = {each.topic: each.msgtype for each in reader.connections}
        edge_ns, begin_ns, end_ns = round(EDGE_S * 1e9), reader.start_time, reader.end_time
        middle_ns = begin_ns + edge_ns, max(end_ns - edge_ns, begin_ns + edge_ns)
        pictures = [each for each in reader.connections if each.msgtype in {IMAGE, COMPRESSED, INFO}]
        images: dict[str, list[Taken]] = defaultdict(list)
        for span in ((None, middle_ns[0]), (middle_ns[1], None)) if pictures else ():
            for topic, taken in _iter_taken(reader, pictures, *span):
                images[topic].append(taken)
        states = [each for each in reader.connections if each.msgtype == JOINTS]
        joints: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
        for topic, taken in _iter_taken(reader, states) if states else ():
            for name, position in zip(taken.message.name, taken.message.position, strict=False):
                if np.isfinite(position):
                    joints[topic][name].append((taken.stamp_ns, taken.logged_ns, [position]))
        fixed, moving, conflicts = _read_transforms(reader)
    return Bag(
        begin_ns=begin_ns,
        end_ns=end_ns,
        types=types,
        images={topic: each for topic, each in images.items() if types[topic] != INFO},
        infos={topic: each for topic, each in images.items() if types[topic] == INFO},
        joints={topic: {name: _join(rows) for name, rows in each.items()} for topic, each in joints.items()},
        fixed=fixed,
        moving=moving,
        conflicts=conflicts,
    )


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
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


def _iter_taken(reader: Any, connections: Any, *span: int | None) -> Iterator[tuple[str, Taken]]:
    for connection, logged_ns, data in reader.messages(connections, *span):
        message = reader.deserialize(data, connection.msgtype)
        yield connection.topic, Taken(_read_stamp(message.header), logged_ns, message)


def _read_stamp(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _join(rows: list[Any]) -> Course:
    """A course of (stamp, recorded, values) in any order; of two with one stamp, the first."""
    stamps = np.array([each[0] for each in rows], np.int64)
    stamps, order = np.unique(stamps, return_index=True)
    lags = np.array([each[1] for each in rows], np.int64)[order] - stamps
    return Course(stamps, np.array([each[2] for each in rows], np.float64)[order], lags)


def _read_transforms(
    reader: Any,
) -> tuple[dict[str, tuple[str, Array]], dict[str, tuple[str, Course]], frozenset[str]]:
    fixed: dict[str, tuple[str, Array]] = {}
    rows: dict[str, list[Any]] = defaultdict(list)
    parents: dict[str, set[str]] = defaultdict(set)
    connections = [each for each in reader.connections if each.msgtype == TRANSFORMS]
    for connection, logged_ns, data in reader.messages(connections) if connections else ():
        for each in reader.deserialize(data, connection.msgtype).transforms:
            child, parent = each.child_frame_id.strip("/"), each.header.frame_id.strip("/")
            place, turned = each.transform.translation, each.transform.rotation
            values = [place.x, place.y, place.z, turned.w, turned.x, turned.y, turned.z]
            if not (np.isfinite(values).all() and any(values[3:])):
                continue
            parents[child].add(parent)
            if connection.topic.endswith("tf_static"):
                step = _interpolate(np.array(values), np.array(values), 0.0)
                if not np.allclose(fixed.setdefault(child, (parent, step))[1], step):
                    parents[child].add(f"{parent}, moved")
            else:
                rows[child].append((_read_stamp(each.header), logged_ns, values))
    moving = {child: (next(iter(parents[child])), _join(each)) for child, each in rows.items()}
    return fixed, moving, frozenset(child for child, each in parents.items() if len(each) > 1)


def _interpolate(a: Array, b: Array, share: float) -> Array:
    """(4, 4) between two transforms (7,), position and quaternion w x y z; along the shorter turn."""
    from scipy.spatial.transform import Rotation, Slerp

    turns = Rotation.from_quat([a[[4, 5, 6, 3]], b[[4, 5, 6, 3]]])
    return make_matrix(Slerp([0.0, 1.0], turns)(share).as_matrix(), a[:3] + share * (b[:3] - a[:3]))


def find_kind(taken: Taken) -> str:
    """`color` or `depth` of a picture; else its encoding, which is not read."""
    if hasattr(taken.message, "format"):
        is_depth = "compressedDepth" in taken.message.format
        return taken.message.format if is_depth or decode_color(taken) is None else "color"
    encoding = str(taken.message.encoding)
    return "color" if encoding in _CHANNELS else "depth" if encoding in _DEPTHS else encoding or "no encoding"


def decode_color(taken: Taken) -> NDArray[np.uint8] | None:
    """(height, width, 3), uint8; None where its bytes are no picture."""
    message = taken.message
    if hasattr(message, "format"):
        decoded = cv2.imdecode(np.asarray(message.data), cv2.IMREAD_COLOR)
        return None if decoded is None else np.ascontiguousarray(decoded[..., ::-1])
    channels, order = _CHANNELS[message.encoding]
    rows = _cut_rows(message, np.dtype(np.uint8), channels)
    return (
        None
        if rows is None
        else np.ascontiguousarray(rows.reshape(message.height, message.width, channels)[..., order])
    )


def decode_depth(taken: Taken) -> NDArray[np.float32] | None:
    """(height, width) along z [m], NaN where nothing was measured; None where its bytes do not fill it."""
    kind, unit_m = _DEPTHS[taken.message.encoding]
    rows = _cut_rows(taken.message, np.dtype(kind).newbyteorder(">" if taken.message.is_bigendian else "<"), 1)
    if rows is None:
        return None
    depth_m = rows.astype(np.float32) * np.float32(unit_m)
    return np.where(np.isfinite(depth_m) & (depth_m > 0.0), depth_m, np.float32(np.nan))


def _cut_rows(message: Any, kind: np.dtype[Any], channels: int) -> NDArray[Any] | None:
    """(height, width * channels) without the filling at the ends of rows."""
    data, width = np.asarray(message.data), message.width * channels * kind.itemsize
    if message.step < width or len(data) != message.step * message.height or not width or not message.height:
        return None
    rows = np.ascontiguousarray(data.reshape(message.height, message.step)[:, :width])
    return rows.view(kind)
