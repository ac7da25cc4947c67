"""Way of a handle that opens or closes what it belongs to."""

from math import ceil

import numpy as np

from phyagentos.geometry import compute_matrix, compute_pose, make_matrix
from phyagentos.protocol.world.entity_geometry import compute_center
from phyagentos.protocol.world.environment import CLOSES_AT, Entity, Mechanism
from phyagentos.protocol.world.mechanisms import compute_motion, find_hinge
from phyagentos.runtime.execution.leaf import Leaf, Port, PortInformation, Role, Status
from phyagentos.runtime.motion.poses import move_pose
from phyagentos.runtime.motion.requests import Array
from phyagentos.runtime.motion.shapes import ROUND_KINDS, compute_shape_boxes

SHUT = 0.2  # of the opening up to which it counts as closed: what shall be closed is left open by no more
STEP_RAD = 0.02  # of a turn between two waypoints: corners are rounded over some of them, by 0.1 mm at a lever of 0.2 m
STAND_OFF_M, PUSH_MORE_M = 0.025, 0.018  # of fingertips from a face; of which they come nearer first
PRESSED_SINE = 0.5  # of a way with the level, downwards
DEPTH_M = 0.02  # of fingertips below the middle of what they push
ALONG = 0.95  # cosine between the hinge and what may turn about it in the fingers


class FindOpening(Leaf):
    """The way of a handle, from the believed opening of what it belongs to, to the wanted one.

    About a hinge the hand turns with the handle, unless the fingers close along the hinge: then the handle turns
    between them. A round bar along the hinge may turn between them, too, where the hand cannot.
    """

    ROLE = Role.SENSE
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity that slides or turns."),
        "part": PortInformation(data_type=str, description="Name of the entity on it that is pushed or pulled."),
        "opening": Port(
            data_type=float,
            minimum=-1.0,
            maximum=1.0,
            description="Wanted fraction of its travel, 0 is closed; less presses beyond that.",
        ),
    }
    OUTPUT_PORTS = {
        "to": PortInformation(
            data_type=tuple, required=False, description="Where its middle shall be, world frame [m]."
        ),
        "waypoints": PortInformation(
            data_type=tuple, required=False, description="Poses world_T_tcp that bring it there from the tool's place."
        ),
        "beside": PortInformation(
            data_type=tuple, required=False, description="Where fingertips begin that shift it by contact [m]."
        ),
        "moves": PortInformation(data_type=tuple, required=False, description="The displacement (4, 4) from there."),
        "push": PortInformation(
            data_type=tuple, required=False, description="Poses world_T_tcp that bring it there from `beside`."
        ),
        "level": PortInformation(
            data_type=tuple, required=False, description="The same with the hand as it is turned now, where it may."
        ),
    }

    def on_start(self) -> Status:
        """Compute once."""
        whole, part = (self.get_entity(self.read(port)) for port in ("object", "part"))
        mechanism = whole.mechanism
        if mechanism is None:
            return self.fail("IMPOSSIBLE", f"{whole.name} neither slides nor turns", object=whole.name)
        wanted = self.read("opening")
        motions = compute_way(whole, mechanism, wanted)
        at_m, tool = np.array(compute_center(part)), compute_matrix(self.context.step.target.tcp)
        ways_m = [motion[:3, :3] @ at_m + motion[:3, 3] - at_m for motion in motions]
        axis = find_hinge(whole)
        level = tuple(compute_pose(move_pose(tool, way_m)) for way_m in ways_m)
        is_pivot = axis is None or abs(tool[:3, 1] @ axis) > ALONG
        turned = level if is_pivot else tuple(compute_pose(motion @ tool) for motion in motions)
        way_m = ways_m[-1]
        x, y, z = (at_m + way_m).tolist()
        self.write("to", (x, y, z))
        beside_m, moves_m = find_contact(part, way_m)
        moves = tuple(make_matrix(np.eye(3), move_m) for move_m in moves_m)
        self.write("beside", beside_m)
        self.write("moves", moves)
        self.write("push", tuple(compute_pose(move @ tool) for move in moves))
        self.write("waypoints", turned)
        self.write("level", level if is_pivot or _is_round_about(part, np.array(axis)) else turned)
        return self.succeed("", object=whole.name, way_m=[round(value, 5) for value in way_m.tolist()])


def compute_way(whole: Entity, mechanism: Mechanism, opening: float) -> tuple[Array, ...]:
    """Displacements (4, 4) in the world that bring an entity from its believed opening to a wanted one, in steps."""
    opening = min(opening, SHUT * mechanism.closes_at) if opening < CLOSES_AT else opening
    way = (opening - (whole.joint or 0.0)) * mechanism.travel
    steps = 1 if mechanism.kind != "hinge" else max(1, ceil(abs(way) / STEP_RAD))
    return tuple(compute_motion(mechanism, way * (index + 1) / steps) for index in range(steps))


def find_contact(part: Entity, way_m: Array) -> tuple[tuple[float, float, float], tuple[Array, ...]]:
    """Where fingertips of a hand from above shift a part along a way (3,), and displacements (3,) from there.

    What goes down is pressed on its top; else they are behind its solid with the largest face across.
    """
    across = way_m * (1.0, 1.0, 0.0)
    across /= max(float(np.linalg.norm(across)), 1e-9)
    solids = [(box.pose[:3, 3], np.abs(box.pose[:3, :3]) @ box.half_m) for box in compute_shape_boxes(part)]
    whole = np.array(compute_center(part)), np.zeros(3)
    center_m, half_m = max(
        solids, key=lambda each: float(each[1].prod() / max(each[1] @ np.abs(across), 1e-6)), default=whole
    )
    if way_m[2] < -PRESSED_SINE * np.linalg.norm(way_m):
        x, y, z = center_m.tolist()
        return (x, y, z + float(half_m[2])), (way_m,)
    x, y, z = (center_m - across * (half_m @ np.abs(across) + STAND_OFF_M)).tolist()
    return (x, y, z - min(float(half_m[2]), DEPTH_M)), (PUSH_MORE_M * across, PUSH_MORE_M * across + way_m)


def _is_round_about(part: Entity, axis: Array) -> bool:
    """Whether a part is one round bar along the hinge (3,)."""
    if len(part.shapes) != 1 or part.shapes[0].kind not in ROUND_KINDS:
        return False
    return bool(abs((compute_matrix(part.pose) @ compute_matrix(part.shapes[0].pose))[:3, 2] @ axis) > ALONG)
