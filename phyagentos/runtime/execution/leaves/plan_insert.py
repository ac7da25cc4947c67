"""Ask for a way of a held peg over a hole, or down into it, each time a little beside the last."""

import numpy as np

from phyagentos.geometry import compute_matrix, compute_pose, to_parent
from phyagentos.protocol.world.entity_geometry import compute_reach
from phyagentos.runtime.execution.leaf import FailureCode, PortInformation, Status
from phyagentos.runtime.execution.planning import LinePlanningLeaf
from phyagentos.runtime.motion.poses import raise_pose
from phyagentos.runtime.motion.requests import MotionRequest, Payload

RIM_M = 0.005  # of the peg's lower end above the rim, between two tries
LEFT_M = 0.0015  # above the floor, at the end of the way down
PITCH_M = 0.0007  # the n-th try is so far from the first one, times the root of n
GOLDEN_RAD = 2.399963  # between two tries: they cover a disc evenly


class PlanInsert(LinePlanningLeaf):
    """Straight ways with a held peg, the hand as it is turned: over the middle of a hole, or down to its floor."""

    INPUT_PORTS = {
        "payload": PortInformation(data_type=Payload, description="The peg, and how it is held."),
        "socket": PortInformation(data_type=str, description="Entity whose interior is the hole."),
        "down": PortInformation(data_type=bool, default_value=False, description="Into it; over it if false."),
        "ignore": PortInformation(data_type=str, required=False, description="Entity that may be touched."),
    }

    def compose(self) -> MotionRequest | Status:
        """One request; each activation downwards shifts the place."""
        payload, entities = self.read("payload"), self.belief.entities
        socket, peg = entities.get(self.read("socket")), entities.get(payload.entity)
        if socket is None or socket.interior is None or peg is None:
            return self.fail(FailureCode.OBJECT_GONE, f"{self.read('socket')} has no hole, or there is no peg")
        tool = compute_matrix(self.context.step.target.tcp)
        held = tool @ compute_matrix(payload.tcp_T_entity)
        x, y, z = to_parent(socket.pose, socket.interior.center_m)
        half_m, tip_m = socket.interior.half_m[2], held[2, 3] - compute_reach(peg, (0.0, 0.0, -1.0))
        is_down = self.read("down")
        index = self.activations - 1 if is_down else 0
        shift = PITCH_M * np.sqrt(index) * np.array((np.cos(GOLDEN_RAD * index), np.sin(GOLDEN_RAD * index)))
        over = tool.copy()
        over[:2, 3] += np.array((x, y)) + shift - held[:2, 3]
        over[2, 3] += z + half_m + RIM_M - tip_m
        if is_down:
            up = raise_pose(tool, max(0.0, float(over[2, 3] - tool[2, 3])))
            ways = [up, over, raise_pose(over, LEFT_M - RIM_M - 2.0 * half_m)]
        else:
            ways = [raise_pose(over, max(0.0, float(tool[2, 3] - over[2, 3]))), over]
        return self.request_line(tuple(map(compute_pose, ways)))
