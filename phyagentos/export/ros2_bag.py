"""One session as a bag of ROS 2: an MCAP file with `metadata.yaml` beside it, which `ros2 bag play` takes.

Frames are those of REP 103 and REP 105: `world`, and `<camera>_optical_frame` for each camera. The time is that of
`session_log`, in the stamps as well.
"""

import heapq
import json
from collections import Counter
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path

import numpy as np

from phyagentos.errors import needs_extra
from phyagentos.export.ros2_markers import iter_markers
from phyagentos.export.ros2_messages import Maker, Message, RosMessage
from phyagentos.export.session_log import Event, SessionLog, find_frames, find_pictures, read_log
from phyagentos.protocol.documents.durable_files import require_empty
from phyagentos.protocol.documents.packed_files import open_packed
from phyagentos.protocol.sessions.looks import StoredFrame, read_picture
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.workspace.array_files import decode_array
from phyagentos.protocol.workspace.workspace import Workspace

VERSION = 8  # of metadata.yaml: that of Jazzy, which later ones read as well


def write_ros2_bag(workspace: Workspace, status: SessionStatus, to: Path) -> None:
    """Write a session as a bag folder.

    Raises:
        DefinitionError: `EXTRA_MISSING`, `NOT_EXECUTED`, `WOULD_OVERWRITE`.
        ExecutionError: `EVIDENCE_DAMAGED`.
    """
    with needs_extra("export", "paos export mcap --ros2"):
        from rosbags.rosbag2 import StoragePlugin, Writer
    require_empty(to)
    log, make = read_log(workspace, status), Maker()
    messages = heapq.merge(
        *(_iter_joints(log, make, *names) for names in (("measured", "states"), ("commanded", "commands"))),
        _iter_pictures(log, make),
        sorted(_iter_frames(log, make), key=itemgetter(0)),
        iter_markers(log, status, make),
        _iter_texts("/tree", log.iter_trace(), make),
        _iter_texts("/session", log.iter_transitions(), make),
        key=itemgetter(0),
    )
    if to.is_dir():
        to.rmdir()
    with Writer(to, version=VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
        topics: dict[str, RosMessage] = {}
        for at_ns, topic, message in messages:
            kind, latched = message.__msgtype__, [make.latched] if topic == "/tf_static" else []
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=make.store, offered_qos_profiles=latched)
            writer.write(topics[topic], at_ns, make.store.serialize_cdr(message, kind))


def _iter_joints(log: SessionLog, make: Maker, which: str, topic: str) -> Iterator[Message]:
    """Joints as measured or commanded; fingers that slide, each by its share of the opening, are joints as well.

    A velocity that was not recorded is NaN, as ros2_control publishes it.
    """
    rows, gripper = log.rows, log.profile.gripper
    fingers = () if gripper.travel else gripper.joints
    names, unknown = [*log.profile.arm.joints, *fingers], np.full(len(fingers), np.nan)
    speeds = rows.get(f"qd_{which}", np.full_like(rows.get(f"q_{which}", unknown), np.nan))
    for index, time_s in enumerate(rows.get("time_s", ())):
        at_ns, share_m = log.place(time_s), rows[f"gripper_{which}_m"][index] / max(len(fingers), 1)
        message = make(
            "sensor_msgs/JointState",
            header=make.head(at_ns),
            name=names,
            position=np.array([*rows[f"q_{which}"][index], *(share_m for _ in fingers)]),
            velocity=np.array([*speeds[index], *unknown]),
            effort=np.zeros(0),
        )
        yield at_ns, f"/joint_{topic}", message


def _iter_pictures(log: SessionLog, make: Maker) -> Iterator[Message]:
    for shown_s, time_s, camera, path, name in find_pictures(log.folder):
        data, head = np.frombuffer(read_picture(path, name), np.uint8), make.head(log.place(time_s), _name(camera))
        message = make("sensor_msgs/CompressedImage", header=head, format="png", data=data)
        yield log.place(shown_s), f"/camera/{camera}/color/image_raw/compressed", message


def _iter_frames(log: SessionLog, make: Maker) -> Iterator[Message]:
    """Lens, place and depth of the frames that perception went by; a camera that never moved stands in /tf_static."""
    frames = [each for each in find_frames(log.folder) if each[1].fx > 0.0]  # earlier versions wrote no lens
    places = dict.fromkeys((each.camera, each.world_T_camera) for _, each in frames)
    moving = {name for name, count in Counter(name for name, _ in places).items() if count > 1}
    for name, pose in places:
        if name not in moving:
            yield log.start_ns, "/tf_static", make.transform(log.start_ns, _name(name), pose)
    for path, frame in frames:
        camera, child, at_ns = frame.camera, _name(frame.camera), log.place(frame.time_s)
        if camera in moving:
            yield at_ns, "/tf", make.transform(at_ns, child, frame.world_T_camera)
        head, size = make.head(at_ns, child), {"height": frame.height, "width": frame.width}
        yield at_ns, f"/camera/{camera}/color/camera_info", _describe_lens(make, frame, head, size)
        with open_packed(path) as file:
            depth_m = decode_array(file.read(frame.depth_m)).astype(np.float32)
        depth = make(
            "sensor_msgs/Image",
            header=head,
            encoding="32FC1",
            is_bigendian=0,
            step=4 * frame.width,
            data=np.ascontiguousarray(depth_m).view(np.uint8).ravel(),
            **size,
        )
        yield at_ns, f"/camera/{camera}/depth/image_rect", depth


def _describe_lens(make: Maker, frame: StoredFrame, head: RosMessage, size: dict[str, int]) -> RosMessage:
    """A lens without distortion; ROS counts pixels by their middles, this project by their edges."""
    k = np.array([frame.fx, 0.0, frame.cx - 0.5, 0.0, frame.fy, frame.cy - 0.5, 0.0, 0.0, 1.0])
    whole = make("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return make(
        "sensor_msgs/CameraInfo",
        header=head,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=k,
        r=np.eye(3).ravel(),
        p=np.insert(k, [3, 6, 9], 0.0),
        binning_x=0,
        binning_y=0,
        roi=whole,
        **size,
    )


def _iter_texts(topic: str, events: Iterator[Event], make: Maker) -> Iterator[Message]:
    for at_ns, value in events:
        yield at_ns, topic, make("std_msgs/String", data=json.dumps(value))


def _name(camera: str) -> str:
    return f"{camera}_optical_frame"
