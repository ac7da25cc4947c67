"""Straight pushes of an object along its support with closed fingers.

The way begins above, goes down behind the object, and straight on until its middle is at the goal. Up to three heights
of contact, two distances behind the object and four turns of the hand are tried: across the push the hand is wide,
along it narrow; at last it leans, as under what juts out. Where something is in the way of object or hand, the first of
several pushes around it is given.
"""

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from msgspec.structs import replace

from phyagentos.geometry import compute_matrix, compute_pose, to_parent
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.protocol.world.entity_geometry import compute_center, compute_centroid, compute_reach, find_surface
from phyagentos.protocol.world.environment import Entity, Pose
from phyagentos.runtime.motion.approaches import SAME_POSTURE_RAD, Screen
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.moves import follow_waypoints
from phyagentos.runtime.motion.planning_scene import PlanningScene
from phyagentos.runtime.motion.poses import interpolate_poses, point_tool_down, raise_pose, tilt_tool
from phyagentos.runtime.motion.requests import Approach, Approaches, Array, FindPush, NoPlan
from phyagentos.runtime.motion.robot_model import measure_fingers
from phyagentos.runtime.motion.shapes import Box, compute_entity_box, compute_shape_boxes, settle

STAND_OFFS_M = (0.03, 0.012)  # gaps between fingers and object before the push
PUSH_HEIGHT_M = 0.02  # above the object's lowest point: low enough that tall objects slide instead of falling over
HIGH_SHARE = 0.45  # of the object's height: the highest contact, below its middle
FRICTION_MAX = 0.6  # of an object on its support: pushed higher than its half width over this, it topples
TIP_M = 0.002  # of room under the fingertips, for an error of the believed height
OVER_M = 0.12  # height above the line at which the tool comes and goes
TURNS_DEG = (0, 180, 90, 270)
LEANS_DEG = (0, 40)  # of a hand that trails behind its fingertips
SHORTEST_M = 0.005  # a push shorter than this is none
POSTURES = 4  # at which one way may begin
ROUTE_STEP_M = 0.08  # between places that the object may be pushed by
ROUTE_ASIDE_M = 0.3  # beyond start and goal
ROUTE_TRIES = 40  # routes that are looked at
PUSHES_MAX = 4
PUSH_COST_M = 0.2  # of one more push, as a way
CLEAR_M = 0.01  # between the object and what it passes, whichever way it turns
FAR_M = 0.5  # behind the object, whatever its size
CELL_M = 0.02  # of the map of what is beside
TOP_BAND_M = 0.015  # between its lowest point and the top of what it stands on


def find_push(
    request: FindPush, entity: Entity, kinematics: Kinematics, scene: PlanningScene, job: Job
) -> Approaches | NoPlan:
    """Ways of the tool from above behind the entity to the end of the push, the nearest first."""
    goal_m = np.asarray(request.to_m)
    length_m = float(np.linalg.norm(goal_m - _find_middle(entity)))
    if length_m < SHORTEST_M:
        return job.fail("IMPOSSIBLE", f"{entity.name} is {1e3 * length_m:.1f} mm from its goal.")
    gripper, half_m = scene.robot.profile.gripper, measure_fingers(scene.robot)
    tall_m = sum(compute_reach(entity, (0.0, 0.0, sign)) for sign in (1.0, -1.0))
    box, palm_m = compute_entity_box(entity), gripper.palm_height_m - gripper.fingertip_m
    least_m = min(PUSH_HEIGHT_M, max(gripper.fingertip_m + TIP_M, 0.5 * tall_m))
    steady_m = float(np.delete(box.half_m, np.abs(box.pose[2, :3]).argmax()).min()) / FRICTION_MAX
    most_m = max(HIGH_SHARE * tall_m, min(steady_m, tall_m - TIP_M), least_m)
    wanted_m = sorted({least_m, max(HIGH_SHARE * tall_m, least_m), max(tall_m - palm_m, least_m)})
    heights_m = [each for each in wanted_m if tall_m - palm_m <= each <= most_m]
    if not heights_m:  # the palm is wider than the fingers
        return job.fail("IMPOSSIBLE", f"{entity.name} is {1e3 * tall_m:.0f} mm tall, the hand would meet or topple it.")
    bottom_m = compute_entity_box(settle(entity, request.world.entities)).bottom_m
    strokes = _Strokes(
        Screen(kinematics, request.q_rad, scene.robot.home_rad, request.seed).seeds,
        bottom_m,
        heights_m,
        half_m,
        kinematics,
        scene,
        job,
    )
    may_go_around = entity.movable and not request.ignore
    floor = _Floor.of(entity, goal_m, bottom_m, bottom_m + tall_m, scene) if may_go_around else None
    is_straight = floor is None or floor.is_straight
    found = strokes.find(entity, goal_m) if is_straight else []
    if not found and floor is not None:
        found = _find_first_of_several(entity, goal_m, floor, strokes)
    if not found and not is_straight:  # it pushes along what it runs into
        found = strokes.find(entity, goal_m)
    if not found:
        return job.fail("NO_IK", f"No push, straight or around obstacles, brings {entity.name} there.")
    found.sort(key=lambda each: float(np.linalg.norm(each.line_rad[0] - request.q_rad)))
    return Approaches(approaches=tuple(found[: request.count]), timing=job.timing, stages=job.stages)


@dataclass(frozen=True, slots=True)
class _Strokes:
    """Straight pushes at `heights_m` above the lowest point of the object, with fingers of `half_m` (2,)."""

    seeds: Array
    bottom_m: float
    heights_m: list[float]
    half_m: Array
    kinematics: Kinematics
    scene: PlanningScene
    job: Job

    def find(self, entity: Entity, to_m: Array) -> list[Approach]:
        """Ways of the tool that push an entity until its middle is at a point (2,)."""
        ways = product(LEANS_DEG, self.heights_m, STAND_OFFS_M, TURNS_DEG)
        for lean_deg, height_m, stand_off_m, degrees in ways:
            if lean_deg and degrees % 180:
                continue
            poses = self._compute(entity, to_m, height_m, stand_off_m, degrees, lean_deg)
            label = f"push+{degrees:03d}.h{round(1e3 * height_m)}.d{round(1e3 * stand_off_m)}"
            label += f".lean{lean_deg}" if lean_deg else ""
            if found := _find_ways(poses, label, self.seeds, self.kinematics, self.scene, self.job):
                return found
        return []

    def look_open(self, entity: Entity, to_m: Array) -> bool:
        """Whether the tool reaches points of a push, a few centimetres apart, without a contact of the hand."""
        self.job.checkpoint()
        for degrees in TURNS_DEG:
            poses = self._compute(entity, to_m, self.heights_m[0], STAND_OFFS_M[-1], degrees)
            above, begin, end = map(compute_matrix, poses)
            line = interpolate_poses(begin, end, ROUTE_STEP_M, np.pi)
            if all(self._reaches(pose) for pose in (begin, end, above, *line[1:-1])):
                return True
        return False

    def _compute(
        self, entity: Entity, to_m: Array, height_m: float, stand_off_m: float, degrees: int, lean_deg: int = 0
    ) -> tuple[Pose, ...]:
        half_m, lean_rad = self.half_m[::-1] if degrees % 180 else self.half_m, np.radians(lean_deg)
        if lean_deg:  # the fingertips come first
            tip_m = self.scene.robot.profile.gripper.fingertip_m
            half_m = half_m * (np.cos(lean_rad), 1.0) + (tip_m * np.sin(lean_rad), 0.0)
        poses = compute_push(entity, to_m, half_m, stand_off_m, self.bottom_m + height_m, np.radians(degrees))
        tilt_rad = lean_rad if degrees == 0 else -lean_rad
        return tuple(compute_pose(tilt_tool(compute_matrix(each), tilt_rad)) for each in poses) if lean_deg else poses

    def _reaches(self, pose: Array) -> bool:
        for seed in self.seeds:
            q_rad = self.kinematics.chain.solve(pose, seed)
            if q_rad is not None:
                pairs = self.scene.find_contacts(q_rad)
                if not pairs or any(self.scene.is_of_tool_pose(pair) for pair in pairs):
                    return not pairs
        return False


@dataclass(frozen=True, slots=True)
class _Floor:
    """Places (n, 2) on the support, start and goal first, and the cost (n, n) of a straight push between two.

    `is_straight` says whether the straight push from start to goal moves the entity into nothing.
    """

    places_m: Array
    cost_m: Array
    is_straight: bool

    @classmethod
    def of(cls, entity: Entity, goal_m: Array, bottom_m: float, top_m: float, scene: PlanningScene) -> "_Floor":
        """Between two places a disc around the entity stays on the support, and meets nothing it moves away from."""
        start_m, box = _find_middle(entity), compute_entity_box(entity)
        radius_m = float(np.linalg.norm(np.abs(box.pose[:2, :3]) @ box.half_m)) + CLEAR_M
        solids = [box for other in scene.obstacles for box in compute_shape_boxes(other)]
        tops = [box for box in solids if abs(box.top_m - bottom_m) <= TOP_BAND_M]
        others = [box for box in solids if box.top_m > bottom_m + TOP_BAND_M and box.bottom_m < top_m]
        low_m, high_m = np.minimum(start_m, goal_m) - ROUTE_ASIDE_M, np.maximum(start_m, goal_m) + ROUTE_ASIDE_M
        sides = [np.arange(low, high, CELL_M) for low, high in zip(low_m, high_m, strict=True)]
        cells = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)
        free_m = _measure_distance(cells, others)
        free_m[_measure_distance(cells, tops) > 0.0] = -1.0
        stride = round(ROUTE_STEP_M / CELL_M)
        lattice = cells[::stride, ::stride][free_m[::stride, ::stride] > radius_m]
        profile = scene.robot.profile
        far_m = np.linalg.norm(lattice - np.asarray(profile.mount_position_m[:2]), axis=1)
        near_m, limit_m = profile.grasp_band_m
        within = (far_m > near_m - ROUTE_STEP_M) & (far_m < limit_m + ROUTE_STEP_M)
        places = np.vstack((start_m, goal_m, lattice[within]))

        def look_up(points: Array) -> Array:
            index = np.clip(np.rint((points - low_m) / CELL_M).astype(int), 0, np.array(free_m.shape) - 1)
            found: Array = free_m[index[..., 0], index[..., 1]]
            return found

        need_m = np.minimum(radius_m, look_up(places))
        cost = np.linalg.norm(places[:, None] - places[None], axis=-1) + PUSH_COST_M
        shares = np.linspace(0.0, 1.0, 2 + int(cost.max() / CELL_M))
        for index, place in enumerate(places):
            way_m = look_up(place + shares[:, None, None] * (places - place))
            cost[index, way_m.min(axis=0) < np.minimum(need_m[index], need_m)] = np.inf
        is_straight = bool(np.isfinite(cost[0, 1]))
        cost[0, np.linalg.norm(places - start_m, axis=1) < ROUTE_STEP_M] = np.inf
        cost[need_m < 0.0] = np.inf
        np.fill_diagonal(cost, np.inf)
        return cls(places, cost, is_straight)


def _find_first_of_several(entity: Entity, goal_m: Array, floor: _Floor, strokes: _Strokes) -> list[Approach]:
    """Ways to push the entity to the first place of the shortest route whose pushes can all be made."""
    cost, known = floor.cost_m.copy(), set[tuple[int, int]]()
    cost[0, 1] = np.inf
    for _ in range(ROUTE_TRIES):
        route = _find_route(cost)
        if not 2 < len(route) <= PUSHES_MAX + 1:
            break
        found: list[Approach] = []
        for a, b in reversed(list(pairwise(route))):
            there, to_m = _shift(entity, floor.places_m[a]), floor.places_m[b]
            if a > 0 and (a, b) in known:
                continue
            found = strokes.find(there, to_m) if strokes.look_open(there, to_m) else []
            if not found:
                cost[a, b] = np.inf
                break
            known.add((a, b))
        else:
            return found
    return []


def _find_route(cost: Array) -> list[int]:
    """Indices of the cheapest way from the first place to the second one; empty where there is none."""
    from scipy.sparse.csgraph import dijkstra  # scipy: only where it is used

    edges = np.where(np.isfinite(cost), cost, 0.0)
    lengths, before = dijkstra(edges, indices=[0], return_predecessors=True)
    route = [1] if np.isfinite(lengths[0, 1]) else []
    while route and route[0] != 0:
        route.insert(0, int(before[0, route[0]]))
    return route


def _measure_distance(points_m: Array, boxes: list[Box]) -> Array:
    """Level distances (...) [m] of points (..., 2) from the nearest box, at the height of its middle."""
    nearest = np.full(points_m.shape[:-1], np.inf)
    for box in boxes:
        local = (points_m - box.pose[:2, 3]) @ box.pose[:2, :3]
        nearest = np.minimum(nearest, np.linalg.norm(np.maximum(np.abs(local) - box.half_m, 0.0), axis=-1))
    return nearest


def _find_middle(entity: Entity) -> Array:
    return np.array(compute_center(entity)[:2])


def _shift(entity: Entity, to_m: Array) -> Entity:
    """The entity with its middle over another point (2,)."""
    x, y = (entity.pose.position_m[:2] + to_m - _find_middle(entity)).tolist()
    pose = Pose((x, y, entity.pose.position_m[2]), entity.pose.quaternion_wxyz)
    return replace(entity, pose=pose)


def _find_ways(
    poses: tuple[Pose, ...], label: str, seeds: Array, kinematics: Kinematics, scene: PlanningScene, job: Job
) -> list[Approach]:
    """The same tool poses from several postures above the first one."""
    tried: list[Array] = []
    found: list[Approach] = []
    above = compute_matrix(poses[0])
    for seed in seeds:
        with job.stage("ik"):
            screened = kinematics.chain.solve(above, seed)
            if screened is None or any(np.abs(screened - other).max() < SAME_POSTURE_RAD for other in tried):
                continue
            tried.append(screened)
            start = kinematics.solve(above, screened, kinematics.polished)
        blocked = [] if start is None else scene.find_contacts(start.q_rad)
        if start is None or blocked:
            job.rejected[Contact(*blocked[0]) if blocked else "ik"] += 1
            continue
        answer = follow_waypoints(start.q_rad, poses[1:], label, kinematics, scene, job)
        if isinstance(answer, Approaches):
            found += answer.approaches
        if len(found) == POSTURES or len(tried) == 2 * POSTURES:
            break
    if not tried:
        job.rejected["ik"] += 1
    return found


def compute_push(
    entity: Entity, goal_m: Array, half_m: Array, stand_off_m: float, z_m: float, turn_rad: float
) -> tuple[Pose, ...]:
    """Poses `world_T_tcp` of closed fingers that push an entity until its middle is at `goal_m` (2,).

    The push goes through the centre of its volume. The fingers reach `half_m` (2,) from the tool centre point along and
    across the push, which begins `stand_off_m` [m] before they meet the entity; `z_m` is the height of the contact in
    the world, `turn_rad` the turn of the hand against the direction of the push.
    """
    way, centroid_m = goal_m - _find_middle(entity), np.array(to_parent(entity.pose, compute_centroid(entity)))
    direction = way / np.linalg.norm(way)
    aside_m, z = np.linspace(-half_m[1], half_m[1], 9)[:, None] * (-direction[1], direction[0]), float(centroid_m[2])
    starts = [(*point, z) for point in (centroid_m[:2] + aside_m - FAR_M * direction).tolist()]
    met_m = [each for start in starts if (each := find_surface(entity, start, (*direction.tolist(), 0.0))) is not None]
    begin_m = centroid_m[:2] - direction * (FAR_M - min(met_m, default=FAR_M) + half_m[0] + stand_off_m)
    yaw_rad = float(np.arctan2(direction[1], direction[0])) + turn_rad
    begin = point_tool_down(yaw_rad, np.array([*begin_m, z_m]))
    end = point_tool_down(yaw_rad, np.array([*(begin_m + way + stand_off_m * direction), z_m]))
    return tuple(compute_pose(pose) for pose in (raise_pose(begin, OVER_M), begin, end))
