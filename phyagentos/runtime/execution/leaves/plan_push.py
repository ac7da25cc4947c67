"""Ask for a straight push of an object along the table."""

import numpy as np

from phyagentos.protocol.environment import Entity, ShapeKind
from phyagentos.runtime.execution.codes import FailureCode
from phyagentos.runtime.execution.leaf import PortInformation, Status
from phyagentos.runtime.execution.planning import LinePlanningLeaf
from phyagentos.runtime.motion.poses import Array, compute_matrix, compute_pose, point_tool_down, raise_pose
from phyagentos.runtime.motion.requests import Approach, FindLine, MotionRequest

FINGER_HALF_M = 0.011  # half thickness of the closed fingers in the direction of a push
STAND_OFF_M = 0.03  # gap between fingers and object before the push
OVER_M = 0.12  # height above the line at which the tool comes and goes
SHORTEST_M = 0.005  # a push shorter than this is none


class PlanPush(LinePlanningLeaf):
    """A way of the closed fingers: down behind the object, straight on until it stands at the goal, and up."""

    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity to push."),
        "to": PortInformation(data_type=tuple, description="Where its centre shall be, world frame [m]."),
    }
    OUTPUT_PORTS = {"approach": PortInformation(data_type=Approach, description="The way, from here to the end.")}

    def compose(self) -> MotionRequest | Status:
        """Waypoints of the tool, from the object's pose and the goal."""
        name = self.read("object")
        entity = self.context.environment().entities.get(name)
        if entity is None:
            return self.fail(FailureCode.OBJECT_GONE, f"{name} is not in the world", object=name)
        goal = np.asarray(self.read("to"), dtype=np.float64)
        center = np.asarray(entity.pose.position_m)
        way = goal[:2] - center[:2]
        length_m = float(np.linalg.norm(way))
        if length_m < SHORTEST_M:
            return self.fail("TOO_SHORT", f"{name} is {1e3 * length_m:.1f} mm from its goal", object=name)
        direction = way / length_m
        reach_m = compute_half_extent(entity, np.array([*direction, 0.0])) + FINGER_HALF_M
        begin = np.array([*(center[:2] - direction * (reach_m + STAND_OFF_M)), center[2]])
        end = np.array([*(goal[:2] - direction * reach_m), center[2]])
        yaw_rad = float(np.arctan2(direction[1], direction[0]))
        down, on = point_tool_down(yaw_rad, begin), point_tool_down(yaw_rad, end)
        poses = (raise_pose(down, OVER_M), down, on, raise_pose(on, OVER_M))
        return FindLine(
            world=self.world(),
            q_rad=self.context.commands.q_rad,
            waypoints=tuple(compute_pose(pose) for pose in poses),
            seed=self.context.draw_seed(self.path),
            ignore=(name,),
        )


def compute_half_extent(entity: Entity, direction: Array) -> float:
    """How far the entity's solids reach from its origin along a world direction [m].

    Args:
        entity: With at least one shape.
        direction: (3,) unit vector, world frame.
    """
    world_T_entity = compute_matrix(entity.pose)
    reach = 0.0
    for shape in entity.shapes:
        world_T_shape = world_T_entity @ compute_matrix(shape.pose)
        axes = np.abs(world_T_shape[:3, :3].T @ direction)
        size = shape.size_m
        if shape.kind is ShapeKind.BOX:
            own = float(axes @ np.asarray(size))
        elif shape.kind is ShapeKind.SPHERE:
            own = size[0]
        else:
            caps = size[1] + (size[0] if shape.kind is ShapeKind.CAPSULE else 0.0)
            own = float(size[0] * np.hypot(axes[0], axes[1]) + caps * axes[2])
        offset = float((world_T_shape[:3, 3] - world_T_entity[:3, 3]) @ direction)
        reach = max(reach, offset + own)
    return reach
