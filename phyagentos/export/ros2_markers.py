"""What rviz and Foxglove draw of a session: objects as believed at its begin and at its end, and the verdict."""

from collections.abc import Iterator

import numpy as np

from phyagentos.export.ros2_messages import WORLD, Maker, Message, RosMessage
from phyagentos.export.session_log import SessionLog
from phyagentos.geometry import Pose, compute_matrix, compute_pose
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.world.environment import Shape, ShapeKind

TOPIC = "/markers"
GREY, GREEN, RED = (0.6, 0.6, 0.6), (0.1, 0.7, 0.2), (0.9, 0.1, 0.1)
HIDDEN, SHOWN = 0.4, 1.0  # opacity of what is believed to be where no camera sees it, and of what was seen
VERDICT_AT, LETTER_M = Pose((0.0, 0.0, 1.0)), 0.05
CUBE, SPHERE, CYLINDER, TEXT = 1, 2, 3, 9  # of visualization_msgs/Marker


def iter_markers(log: SessionLog, status: SessionStatus, make: Maker) -> Iterator[Message]:
    """The world before, the world after, and the verdict; each as far as it is recorded."""
    for world in log.worlds:
        at_ns, markers = log.place(world.time_s), list[RosMessage]()
        for name, entity in world.entities.items():
            paint = (*(entity.rgb or GREY), SHOWN if entity.visible else HIDDEN)
            for number, shape in enumerate(entity.shapes):
                pose = compute_pose(compute_matrix(entity.pose) @ compute_matrix(shape.pose))
                markers.append(_mark(make, at_ns, (f"objects/{name}", number), _measure(shape), pose, paint))
        yield at_ns, TOPIC, make("visualization_msgs/MarkerArray", markers=markers)
    if (decided := status.decision) is not None:
        at_ns = log.place(log.start_s + log.duration_s)
        lines = [
            f"{status.contract.id}: {decided.verdict}",
            *(f"{each.text}: {each.truth}" for each in decided.criteria),
        ]
        paint = (*(RED if decided.verdict.is_miss else GREEN), SHOWN)
        form = (TEXT, (0.0, 0.0, LETTER_M))
        marker = _mark(make, at_ns, ("verdict", 0), form, VERDICT_AT, paint, "\n".join(lines))
        yield at_ns, TOPIC, make("visualization_msgs/MarkerArray", markers=[marker])


def _measure(shape: Shape) -> tuple[int, tuple[float, ...]]:
    """The kind of a marker and its whole extents [m]; a capsule is drawn as a cylinder as long as the whole."""
    first, *others = (2.0 * each for each in shape.size_m)
    if shape.kind is ShapeKind.BOX:
        return CUBE, (first, *others)
    if shape.kind is ShapeKind.SPHERE:
        return SPHERE, (first,) * 3
    return CYLINDER, (first, first, others[0] + (first if shape.kind is ShapeKind.CAPSULE else 0.0))


def _mark(
    make: Maker,
    at_ns: int,
    name: tuple[str, int],
    form: tuple[int, tuple[float, ...]],
    pose: Pose,
    rgba: tuple[float, ...],
    text: str = "",
) -> RosMessage:
    return make(
        "visualization_msgs/Marker",
        header=make.head(at_ns, WORLD),
        ns=name[0],
        id=name[1],
        type=form[0],
        action=0,
        pose=make.pose(pose),
        scale=make("geometry_msgs/Vector3", **dict(zip("xyz", form[1], strict=True))),
        color=make("std_msgs/ColorRGBA", **dict(zip("rgba", rgba, strict=True))),
        lifetime=make("builtin_interfaces/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=make("sensor_msgs/CompressedImage", header=make.head(0), format="", data=np.zeros(0, np.uint8)),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=make("visualization_msgs/MeshFile", filename="", data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )
