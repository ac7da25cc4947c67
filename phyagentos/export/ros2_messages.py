"""Messages of ROS 2 by rosbags, which needs no ROS: headers, places and frames."""

from typing import Any

from phyagentos.geometry import Pose

WORLD = "world"
RosMessage = Any  # rosbags makes its types as it runs
Message = tuple[int, str, RosMessage]
"""When it is logged [ns], on which topic, and the message."""


class Maker:
    """Makes messages of ROS 2; their types are those of Jazzy, which Humble and Kilted share."""

    def __init__(self) -> None:
        from rosbags.interfaces import (
            Qos,
            QosDurability,
            QosHistory,
            QosLiveliness,
            QosReliability,
            QosTime,
        )
        from rosbags.typesys import Stores, get_typestore

        self.store, always = get_typestore(Stores.ROS2_JAZZY), QosTime(0, 0)
        self.latched = Qos(
            QosHistory.KEEP_LAST,
            1,
            QosReliability.RELIABLE,
            QosDurability.TRANSIENT_LOCAL,
            always,
            always,
            QosLiveliness.AUTOMATIC,
            always,
            avoid_ros_namespace_conventions=False,
        )

    def __call__(self, kind: str, **fields: RosMessage) -> RosMessage:
        """A message of a type such as `sensor_msgs/Image`."""
        return self.store.types[kind.replace("/", "/msg/")](**fields)

    def head(self, at_ns: int, frame: str = "") -> RosMessage:
        """A header."""
        stamp = self("builtin_interfaces/Time", sec=at_ns // 1_000_000_000, nanosec=at_ns % 1_000_000_000)
        return self("std_msgs/Header", stamp=stamp, frame_id=frame)

    def pose(self, pose: Pose) -> RosMessage:
        """A place with a turn."""
        w, x, y, z = pose.quaternion_wxyz
        point = self("geometry_msgs/Point", **dict(zip("xyz", pose.position_m, strict=True)))
        return self(
            "geometry_msgs/Pose", position=point, orientation=self("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)
        )

    def transform(self, at_ns: int, child: str, pose: Pose) -> RosMessage:
        """A frame in the world."""
        place = self("geometry_msgs/Vector3", **dict(zip("xyz", pose.position_m, strict=True)))
        turned = self("geometry_msgs/Transform", translation=place, rotation=self.pose(pose).orientation)
        stamped = self(
            "geometry_msgs/TransformStamped", header=self.head(at_ns, WORLD), child_frame_id=child, transform=turned
        )
        return self("tf2_msgs/TFMessage", transforms=[stamped])
