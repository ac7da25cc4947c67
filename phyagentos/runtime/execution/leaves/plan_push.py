"""Ask for a straight push of an object along the table."""

import numpy as np

from phyagentos.geometry import compute_pose
from phyagentos.protocol.world.environment import Entity, Pose
from phyagentos.protocol.world.predicates.geometry import compute_reach
from phyagentos.runtime.execution.leaf import FailureCode, PortInformation, Role, Status
from phyagentos.runtime.execution.planning import CandidatePlanningLeaf
from phyagentos.runtime.motion.poses import point_tool_down, raise_pose
from phyagentos.runtime.motion.requests import Approaches, Array, FindLine, MotionRequest
from phyagentos.runtime.perception.world_model import BELIEF

STAND_OFF_M = 0.03  # gap between fingers and object before the push
PUSH_HEIGHT_M = 0.02  # above the object's lowest point: low enough that tall things slide instead of falling over
OVER_M = 0.12  # height above the line at which the tool comes and goes
SHORTEST_M = 0.005  # a push shorter than this is none


class PlanPush(CandidatePlanningLeaf):
    """A way of the closed fingers: down behind the object, straight on until it stands at the goal.

    The way begins at one of the hover postures of `approaches`, or at the present posture without any, as for an object
    that cannot be gripped. Closed fingers are symmetric, so each start is tried with two turns of the hand.
    """

    ROLE = Role.PLAN
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity to push."),
        "to": PortInformation(data_type=tuple, description="Where its centre shall be, world frame [m]."),
        "approaches": PortInformation(
            data_type=Approaches, required=False, description="Postures near the object to begin from."
        ),
    }
    OUTPUT_PORTS = {"ways": PortInformation(data_type=Approaches, description="One way, to be reached and followed.")}

    def compose(self) -> MotionRequest | Status:
        """Waypoints of the tool, from the object's pose and the goal."""
        name = self.read("object")
        entity = self.context.world.observe(BELIEF).entities.get(name)
        if entity is None:
            return self.fail(FailureCode.OBJECT_GONE, f"{name} is not in the world", object=name)
        goal = np.asarray(self.read("to"), dtype=np.float64)
        way = goal[:2] - np.asarray(entity.pose.position_m[:2])
        length_m = float(np.linalg.norm(way))
        if length_m < SHORTEST_M:
            return self.fail("TOO_SHORT", f"{name} is {1e3 * length_m:.1f} mm from its goal", object=name)
        tall_m = sum(compute_reach(entity, (0.0, 0.0, sign)) for sign in (1.0, -1.0))
        gripper = self.context.profile.gripper
        if tall_m > gripper.palm_height_m:  # the palm is wider than the fingers
            return self.fail("TOO_TALL", f"{name} is {1e3 * tall_m:.0f} mm tall, the hand would meet it", object=name)
        start, turned = divmod(self.tried, 2)
        return FindLine(
            world=self.world(),
            q_rad=self._find_starts()[start],
            waypoints=compute_push(entity, goal[:2], way / length_m, gripper.finger_half_m, turned=bool(turned)),
            seed=self.context.draw_seed(self.path),
            ignore=(name, entity.part_of) if entity.part_of else (name,),  # a drawer moves with its handle
        )

    def count_candidates(self) -> int:
        """Each start with two turns of the hand."""
        return 2 * len(self._find_starts())

    def on_found(self, answer: Approaches) -> Status:
        """Write the way."""
        self.write("ways", answer)
        return self.succeed("", tried=self.tried + 1)

    def _find_starts(self) -> list[Array]:
        """Postures (n_joints,) at which the way may begin."""
        approaches = self.find("approaches")
        return [each.line_rad[0] for each in approaches.approaches] if approaches else [self.context.commands.q_rad]


def compute_push(
    entity: Entity, goal_m: Array, direction: Array, finger_half_m: float, *, turned: bool
) -> tuple[Pose, ...]:
    """Poses `world_T_tcp` of closed fingers that push an entity along `direction` (2,), a unit vector.

    `goal_m` (2,) is the goal of its origin; `finger_half_m` [m] half the thickness of the closed fingers in that
    direction; `turned` turns the hand by half a turn.
    """
    center = np.asarray(entity.pose.position_m)
    reach_m = compute_reach(entity, (*direction.tolist(), 0.0)) + finger_half_m
    height_m = center[2] - compute_reach(entity, (0.0, 0.0, -1.0)) + PUSH_HEIGHT_M
    yaw_rad = float(np.arctan2(direction[1], direction[0])) + (np.pi if turned else 0.0)
    begin = point_tool_down(yaw_rad, np.array([*(center[:2] - direction * (reach_m + STAND_OFF_M)), height_m]))
    end = point_tool_down(yaw_rad, np.array([*(goal_m - direction * reach_m), height_m]))
    return tuple(compute_pose(pose) for pose in (raise_pose(begin, OVER_M), begin, end))
