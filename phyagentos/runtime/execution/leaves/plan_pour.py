"""Ask for a way of a held vessel beside a bowl, and for tipping it there about the edge of its mouth."""

from itertools import product

import numpy as np

from phyagentos.geometry import compute_matrix, compute_pose, make_matrix, to_parent, turn
from phyagentos.runtime.execution.leaf import FailureCode, PortInformation, Status
from phyagentos.runtime.execution.planning import CandidatePlanningLeaf
from phyagentos.runtime.motion.poses import raise_pose
from phyagentos.runtime.motion.requests import Approach, Approaches, Array, FindLine, MotionRequest, Payload

ABOVE_M = (0.03, 0.05, 0.07, 0.09)  # of the edge above the bowl's rim in the end, lowest first
CLEAR_M = 0.02  # of the vessel's lower end above the rim, while it is tipped
SHORT_M = 0.02  # of the edge before the bowl's middle: what leaves the mouth flies on
AZIMUTHS_DEG = (0, 30, -30, 60, -60, 90, -90)  # of the mouth, from the way to the robot's base
CANDIDATES = tuple(product(ABOVE_M, AZIMUTHS_DEG, (1, -1)))  # at the last, the hand turned either way
TIPS_RAD = np.linspace(0.0, 1.92, 21)


class PlanPour(CandidatePlanningLeaf):
    """Two ways with a held vessel: upright to where its edge is over a bowl, and from there about that edge."""

    INPUT_PORTS = {
        "payload": PortInformation(data_type=Payload, description="The vessel, and how it is held."),
        "into": PortInformation(data_type=str, description="Entity whose interior receives what it holds."),
    }
    OUTPUT_PORTS = {
        "over": PortInformation(data_type=Approach, description="The upright path, from here to beside the bowl."),
        "tip": PortInformation(data_type=Approach, description="The turn about the edge, from there."),
    }

    _over: tuple[tuple[int, int], Approach] | None = None  # of an activation's candidate

    def count_candidates(self) -> int:
        """Directions of the mouth, at rising heights."""
        return len(CANDIDATES)

    def compose(self) -> MotionRequest | Status:
        """The upright way of a candidate; once that is found, its turn."""
        payload, entities = self.read("payload"), self.belief.entities
        bowl, vessel = entities.get(self.read("into")), entities.get(payload.entity)
        if bowl is None or bowl.interior is None or vessel is None or vessel.interior is None:
            return self.fail(FailureCode.OBJECT_GONE, f"{self.read('into')} or {payload.entity} has no interior")
        above_m, degrees, side = CANDIDATES[self.tried]
        tool = compute_matrix(self.context.step.target.tcp)
        x, y, z = to_parent(bowl.pose, bowl.interior.center_m)
        base_x, base_y, _ = self.context.profile.mount_position_m
        away = np.arctan2(base_y - y, base_x - x) + np.radians(degrees)
        mouth = np.array((np.cos(away), np.sin(away), 0.0))
        edge_m = np.array((x, y, z + bowl.interior.half_m[2])) - SHORT_M * mouth
        closing = np.arctan2(tool[1, 1], tool[0, 1])
        over = tool.copy()
        over[:3, :3] = turn(np.array((0.0, 0.0, away + side * np.pi / 2 - closing))) @ tool[:3, :3]
        held = over @ compute_matrix(payload.tcp_T_entity)
        half_m, center_m = vessel.interior.half_m, vessel.interior.center_m
        rim_m = held[:3, :3] @ np.array((*center_m[:2], center_m[2] + half_m[2])) + held[:3, 3]
        over[:3, 3] += edge_m - rim_m - min(half_m[:2]) * mouth
        rises_m = np.maximum(above_m, 2.0 * half_m[2] * np.cos(TIPS_RAD) + CLEAR_M)  # the lower end clears the rim
        ways = [_tip(over, edge_m, mouth, tip, rise) for tip, rise in zip(TIPS_RAD, rises_m, strict=True)]
        begin = self._find_over()
        if begin is None:
            rise_m = float(ways[0][2, 3] - tool[2, 3])
            ways = [raise_pose(tool, max(0.0, rise_m)), raise_pose(ways[0], max(0.0, -rise_m)), ways[0]]
        return self.request(
            FindLine,
            q_rad=self.context.commands.q_rad if begin is None else begin.line_rad[-1],
            waypoints=tuple(map(compute_pose, ways)),
            payload=payload,
        )

    def on_found(self, answer: Approaches) -> Status:
        """Ask for the turn, or write both ways."""
        over = self._find_over()
        if over is None:
            self._over = (self.activations, self.tried), answer.approaches[0]
            return self.ask()
        self.write("over", over)
        self.write("tip", answer.approaches[0])
        return self.succeed("", tried=self.tried + 1)

    def _find_over(self) -> Approach | None:
        key, approach = self._over or (None, None)
        return approach if key == (self.activations, self.tried) else None


def _tip(pose: Array, edge_m: Array, mouth: Array, tip_rad: float, rise_m: float) -> Array:
    """A pose (4, 4), turned about an edge through a point (3,) towards the mouth (3,), and raised."""
    rotation = turn(tip_rad * np.cross((0.0, 0.0, 1.0), mouth))
    return raise_pose(
        T=make_matrix(rotation @ pose[:3, :3], edge_m + rotation @ (pose[:3, 3] - edge_m)), height_m=rise_m
    )
