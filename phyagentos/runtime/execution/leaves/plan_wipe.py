"""Ask for a way of a held block to the corner of an area, or in strokes over the area."""

import numpy as np
from msgspec.structs import replace

from phyagentos.geometry import compute_matrix, compute_pose, turn
from phyagentos.runtime.execution.leaf import FailureCode, PortInformation, Status
from phyagentos.runtime.execution.planning import LinePlanningLeaf
from phyagentos.runtime.motion.poses import raise_pose
from phyagentos.runtime.motion.requests import Array, MotionRequest, Payload
from phyagentos.runtime.motion.shapes import compute_entity_box

OVER_M = 0.015  # of the block above the floor of the area, before it is lowered
PRESS_M = 0.0015  # of the set-points below the height of contact: joints yield, and press with some 10 N
EDGE_M = 0.012  # past the sides of the area: what a pose in the hand may be off, and more
OVERLAP_M = 0.012  # of neighbouring strokes


class PlanWipe(LinePlanningLeaf):
    """A way to just above the nearest corner, outside of the area, or strokes to and fro from there, in contact."""

    INPUT_PORTS = {
        "payload": PortInformation(data_type=Payload, description="The block, and how it is held."),
        "area": PortInformation(data_type=str, description="Region to wipe."),
        "strokes": PortInformation(data_type=bool, default_value=False, description="Over it; to its corner if false."),
        "ignore": PortInformation(data_type=str, required=False, description="Entity that may be touched."),
    }

    def compose(self) -> MotionRequest | Status:
        """One request; strokes push along what is lower than the middle of the pads."""
        payload, world = self.read("payload"), self.belief
        area, block = world.regions.get(self.read("area")), world.entities.get(payload.entity)
        if area is None or block is None:
            return self.fail(FailureCode.OBJECT_GONE, f"there is no area {self.read('area')}, or no {payload.entity}")
        tool, frame = compute_matrix(self.context.step.target.tcp), compute_matrix(area.pose)
        box = compute_entity_box(replace(block, pose=compute_pose(tool @ compute_matrix(payload.tcp_T_entity))))
        own = frame[:3, :3].T @ box.pose[:3, :3]
        level = own[:2, (int(np.argmax(np.abs(own[2]))) + 1) % 3]
        yaw_rad = float(np.arctan2(level[1], level[0]))
        square = turn((0.0, 0.0, np.round(2 * yaw_rad / np.pi) * np.pi / 2 - yaw_rad))  # sides along those of the area
        corners = list_corners(
            np.array(area.half_m),
            np.abs(square @ own) @ box.half_m,
            from_m=(box.pose[:2, 3] - frame[:2, 3]) @ frame[:2, :2],
        )
        poses = np.repeat(tool[None], len(corners), axis=0)
        poses[:, :3, :3] = square @ tool[:3, :3]
        poses[:, :2, 3] = corners @ frame[:2, :2].T + frame[:2, 3] + (square @ (tool - box.pose)[:3, 3])[:2]
        if not self.read("strokes"):
            down_m = frame[2, 3] - area.half_m[2] + OVER_M - box.bottom_m
            return self.request_line((compute_pose(poses[0]), compute_pose(raise_pose(poses[0], down_m))))
        request = self.request_line(tuple(compute_pose(raise_pose(pose, -PRESS_M)) for pose in poses[1:]))
        entities = (each for each in request.world.entities if each.movable and each.shapes)
        low = (each.name for each in entities if compute_entity_box(each).top_m < tool[2, 3])
        return replace(request, ignore=(*request.ignore, *low))


def list_corners(half_m: Array, reach_m: Array, from_m: Array) -> Array:
    """(k, 2) ends of the strokes in the frame of an area, past all its sides; the first is the nearest to `from_m`.

    `half_m` is of the area, `reach_m` of the block along its axes; strokes are across the longer side of the block.
    """
    across = int(np.argmax(reach_m[:2]))
    room_m = max(0.0, half_m[across] + EDGE_M - reach_m[across])
    lanes = np.linspace(room_m, -room_m, 1 + int(np.ceil(2 * room_m / (2 * reach_m[across] - OVERLAP_M))))
    end_m = half_m[1 - across] + reach_m[1 - across] + EDGE_M
    ends = [
        (sign * end_m, lane) for index, lane in enumerate(lanes) for sign in ((1, -1) if index % 2 == 0 else (-1, 1))
    ]
    return np.array(ends)[:, :: 1 if across else -1] * np.where(from_m < 0.0, -1.0, 1.0)
