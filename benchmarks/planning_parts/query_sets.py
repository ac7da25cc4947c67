"""Queries of three kinds for any arm: recorded pick-and-place, objects in a shelf, free postures in random clutter."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from benchmarks.recorded import Robot, record_tidy_table
from phyagentos.geometry import compute_inverse, compute_matrix, compute_pose
from phyagentos.protocol.world.environment import Entity, Pose, Region, Shape, ShapeKind
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.planning_scene import PlanningScenes
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.motion.requests import (
    Approaches,
    Array,
    FindGrasps,
    FindPlacements,
    Motion,
    MotionAnswer,
    MotionRequest,
    Payload,
    PlanMove,
    World,
)

Find = FindGrasps | FindPlacements
BOXES = 12  # of a clutter
GOALS = 4  # that a query in a clutter offers
TRIES = 400


@dataclass(frozen=True, slots=True)
class Query:
    """What is asked of a planner: tool poses to be found first (`find`), if any, and a motion to one of them."""

    find: Find | None
    move: PlanMove


class Tap:
    """Answers requests by a planner and keeps every search for goals that was followed by a motion to one of them."""

    def __init__(self, planner: MotionPlanner) -> None:
        self._planner = planner
        self._found: tuple[Find, Approaches] | None = None
        self.queries: list[Query] = []

    def answer(self, request: MotionRequest, should_cancel: Callable[[], bool] = lambda: False) -> MotionAnswer:
        """The planner's answer."""
        answer = self._planner.answer(request, should_cancel)
        if isinstance(request, FindGrasps | FindPlacements) and isinstance(answer, Approaches):
            self._found = request, answer
        elif isinstance(request, PlanMove) and self._found is not None:
            find, approaches = self._found
            hovers = np.array([each.line_rad[0] for each in approaches.approaches])
            if hovers.shape == np.shape(request.goals_rad) and np.array_equal(hovers, request.goals_rad):
                self.queries.append(Query(find, request))
        return answer


def record_queries(robot: Robot, planner: MotionPlanner, count: int, seed: int) -> list[Query]:
    """Grasps and placements of `tidy_table`, as sessions in a simulated world asked for them."""
    tap = Tap(planner)
    while len(tap.queries) < count:
        record_tidy_table(robot, (seed,), planner=LocalPlanner(tap))  # type: ignore[arg-type]
        seed += 1
    return tap.queries[:count]


def draw_shelf_queries(planner: MotionPlanner, count: int, seed: int) -> list[Query]:
    """Into a shelf, to grasp a can between its boards, and out of it with the can; in turn.

    A scene in which this planner finds no grasp, or no place outside, asks nothing of any planner, and is drawn again.
    """
    queries: list[Query] = []
    home, rng, scenes = planner.robot.home_rad, np.random.default_rng(seed), PlanningScenes(planner.robot)
    while len(queries) < count:
        world = _build_shelf(planner, rng)
        if not scenes.get_scene(world).is_free(home):
            continue
        find = FindGrasps(world=world, object="can", q_rad=home, seed=seed)
        into = _follow(planner, find, home, None)
        if into is None:
            continue
        queries.append(into)
        motion = planner.answer(into.move)
        if not isinstance(motion, Motion):
            continue
        grasp = planner.answer(find).approaches[motion.goal]  # type: ignore[union-attr]
        can = next(each for each in world.entities if each.name == "can")
        in_hand = compute_inverse(compute_matrix(grasp.tcp_end)) @ compute_matrix(can.pose)
        held = Payload("can", compute_pose(in_hand), 0.052)
        place = FindPlacements(
            world=world, payload=held, destination="beside", q_rad=grasp.line_rad[0], seed=seed, relation="inside"
        )
        out = _follow(planner, place, grasp.line_rad[0], held)
        if out is not None:
            queries.append(out)
    return queries[:count]


def _follow(planner: MotionPlanner, find: Find, q_rad: Array, payload: Payload | None) -> Query | None:
    found = planner.answer(find)
    if not isinstance(found, Approaches):
        return None
    goals = np.array([each.line_rad[0] for each in found.approaches])
    return Query(find, PlanMove(world=find.world, q_rad=q_rad, goals_rad=goals, seed=find.seed, payload=payload))


def _build_shelf(planner: MotionPlanner, rng: np.random.Generator) -> World:
    """A shelf of two storeys before the arm, a can in the upper or on the lower one, and room beside it."""
    near_m, far_m = planner.robot.profile.grasp_band_m
    at_m, side_m = rng.uniform(0.5 * (near_m + far_m), far_m), rng.uniform(-0.1, 0.1)
    storey, depth_m, half_m = rng.integers(2), 0.09, rng.uniform(0.17, 0.22)
    low_m = rng.uniform(0.2, 0.24)
    high_m = low_m + rng.uniform(0.2, 0.24)
    boards = [_box((0, 0, z), (depth_m, half_m, 0.008)) for z in (low_m, high_m)]
    sides = [_box((0, sign * half_m, high_m / 2), (depth_m, 0.008, high_m / 2)) for sign in (-1, 1)]
    back = _box((depth_m, 0, high_m / 2), (0.008, half_m, high_m / 2))
    stands_m = 0.0 if storey == 0 else low_m + 0.008
    can_m = (at_m - rng.uniform(0.03, 0.05), side_m + rng.uniform(-0.4, 0.4) * half_m, stands_m + 0.041)
    can = Entity(name="can", kind="can", pose=Pose(can_m), shapes=(Shape(ShapeKind.CYLINDER, (0.026, 0.04)),))
    post_y = -0.3 if side_m > 0 else 0.3
    return World(
        entities=(
            _fixed("table", (0.4, 0.0, -0.02), _box((0, 0, 0), (0.5, 0.7, 0.02))),
            _fixed("shelf", (at_m, side_m, 0.0), *boards, *sides, back),
            _fixed("post", (near_m, 0.5 * post_y, 0.0), _box((0, 0, 0.15), (0.02, 0.02, 0.15))),
            can,
        ),
        regions=(
            Region(name="beside", pose=Pose((near_m, post_y - 0.1 * np.sign(post_y), 0.05)), half_m=(0.1, 0.1, 0.05)),
        ),
    )


def draw_clutter_queries(planner: MotionPlanner, count: int, seed: int) -> list[Query]:
    """From a free posture to the nearest of up to four free ones, among boxes at random about the arm."""
    rng, queries, robot = np.random.default_rng(seed), list[Query](), planner.robot
    scenes = PlanningScenes(robot)
    while len(queries) < count:
        boxes = [_draw_box(f"box{index}", rng) for index in range(BOXES)]
        world = World((_fixed("table", (0.4, 0.0, -0.02), _box((0, 0, 0), (0.5, 0.7, 0.02))), *boxes))
        scene = scenes.get_scene(world)
        drawn = rng.uniform(
            np.maximum(robot.q_min_rad, -2.5), np.minimum(robot.q_max_rad, 2.5), (TRIES, len(robot.q_min_rad))
        )
        free = [q for q in drawn if scene.is_free(q)][: 1 + GOALS]
        if len(free) < 2:
            continue
        queries.append(Query(None, PlanMove(world=world, q_rad=free[0], goals_rad=np.array(free[1:]), seed=seed)))
    return queries


def _draw_box(name: str, rng: np.random.Generator) -> Entity:
    angle, away_m = rng.uniform(-np.pi, np.pi), rng.uniform(0.35, 0.8)
    position = (float(away_m * np.cos(angle)), float(away_m * np.sin(angle)), float(rng.uniform(0.1, 0.9)))
    turn = rng.normal(size=4)
    pose = Pose(position, tuple((turn / np.linalg.norm(turn)).tolist()))
    return replace(_fixed(name, position, _box((0, 0, 0), rng.uniform(0.03, 0.1, 3))), pose=pose)


def _box(position_m: tuple[float, ...], half_m: Array | tuple[float, ...]) -> Shape:
    return Shape(ShapeKind.BOX, tuple(map(float, half_m)), Pose(tuple(map(float, position_m))))


def _fixed(name: str, position_m: tuple[float, ...], *shapes: Shape) -> Entity:
    pose = Pose(tuple(map(float, position_m)))
    return Entity(name=name, kind=name, movable=False, pose=pose, shapes=shapes)
