"""A collision-free timed motion to any of several postures, or a straight motion of the tool through given poses.

The path is searched on spheres, rounded, timed, and checked exactly in fine steps. A row in contact repeats the work,
first with denser corners, then with larger spheres, then on the exact model in as fine steps, with another seed. A
start in contact begins with a short escape. Spheres that refuse a start or goal that is free in truth are made smaller.
Where they leave no path, the exact model is searched, unless it is other robots that are in the way.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from phyagentos.geometry import compute_matrix
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics, combine
from phyagentos.runtime.motion.path import (
    ITERATIONS,
    ITERATIONS_CROWDED,
    Checker,
    Path,
    Query,
    compute_length,
    densify,
    find_path,
    round_corners,
)
from phyagentos.runtime.motion.planning_scene import Pair, PlanningScene
from phyagentos.runtime.motion.requests import (
    Approach,
    Approaches,
    Array,
    Differential,
    GoalPosture,
    Motion,
    NoPlan,
    PathSearch,
    PlanMove,
    Stages,
)
from phyagentos.runtime.motion.sphere_checker import SphereChecker
from phyagentos.runtime.motion.sphere_model import SphereArrays, SphereModel, measure_steps
from phyagentos.runtime.motion.timing import Timed

TimeRows = Callable[[Array], Timed]
"""Times a path (k, n_joints)."""

ATTEMPTS = 3
DENSE_RAD = 0.05
FINE_RAD = 0.005  # moves what is held by less than a wall of 5 mm is thick
CHECK_M = 0.002  # between two checks any point of the robot moves by no more than the margin around objects
_SEED_STRIDE = 101
LARGER_M = 0.005  # so much the spheres grow where a motion touched something that they did not see
ESCAPE_RADII_RAD = (0.05, 0.1, 0.2, 0.35)  # the nearest way out first
ESCAPE_DIRECTIONS = 48  # tried at each radius
ESCAPE_STEP_RAD = 0.02
ROUNDING_PASSES = 6  # over rows 1 cm apart: a right angle is cut by some 5 mm


@dataclass(frozen=True, slots=True)
class _Search:
    query: Query
    arrays: SphereArrays
    checker: Checker
    goals: list[int]
    name: str
    stuck_rad: Array | None = None  # where the arm touches something; the query starts where it no longer does
    touched: tuple[Pair, ...] = ()


def plan_move(
    request: PlanMove, scene: PlanningScene, spheres: SphereModel, time_rows: TimeRows, job: Job
) -> Motion | NoPlan:
    """The motion, timed by `time_rows`, or why there is none."""
    with job.stage("model"):
        prepared = _prepare(request, scene, spheres, job)
    if isinstance(prepared, NoPlan):
        return prepared
    for attempt in range(ATTEMPTS):
        with job.stage("path"):
            prepared, path = _search(prepared, scene, request.seed + _SEED_STRIDE * attempt, job.should_cancel)
        job.checkpoint()
        if path is None:
            job.crowded_by.update(scene.crowd)
            return job.fail("NO_PLAN", f"No path to any of {len(prepared.goals)} goals was found in the budget.")
        timed = _time_and_check(path, prepared, scene, time_rows, job)
        if timed is None and attempt == 0 and isinstance(prepared.checker, SphereChecker):
            prepared = replace(
                prepared, checker=_fit(prepared.checker.arrays.grow(LARGER_M), prepared.query), name="larger spheres"
            )
        elif timed is None:
            scene.finest_rad = FINE_RAD
            prepared = replace(prepared, checker=scene, name="exact, fine")
        else:
            search = PathSearch(
                planner=path.planner,
                checker=prepared.name,
                goals=len(prepared.goals),
                iterations=path.iterations,
                attempts=attempt + 1,
                exact_checks=scene.checks,
                length_rad=round(compute_length(path.rows_rad), 4),
            )
            return Motion(
                trajectory=timed.trajectory,
                goal=prepared.goals[path.goal],
                timing=job.timing,
                stages=Stages(path=search, scaling=timed.scaling),
            )
    return job.fail("IN_COLLISION", f"{ATTEMPTS} paths were found, but none stayed free of contact once timed.")


def _prepare(request: PlanMove, scene: PlanningScene, spheres: SphereModel, job: Job) -> _Search | NoPlan:
    q_min, q_max = scene.robot.q_min_rad, scene.robot.q_max_rad
    start = np.clip(np.asarray(request.q_rad, dtype=float), q_min, q_max)
    goals = np.atleast_2d(np.asarray(request.goals_rad, dtype=float))
    stuck, touched = None, tuple(scene.find_contacts(start))
    if touched:
        stuck, free_start = start, find_escape(start, touched, scene, request.seed)
        if free_start is None:
            job.rejected[Contact(*touched[0])] += 1
            return job.fail("IN_COLLISION", f"The arm touches something and finds no way out: {Contact(*touched[0])}.")
        start = free_start
    free: list[int] = []
    for index, goal in enumerate(goals):
        contacts = scene.find_contacts(goal)
        if contacts:
            job.rejected[Contact(*contacts[0])] += 1
        elif np.any(goal < q_min) or np.any(goal > q_max):
            job.rejected["joint limit"] += 1
        else:
            free.append(index)
    if not free:
        return job.fail("IN_COLLISION", f"None of {len(goals)} goal postures is free.")
    arrays, most = spheres.build_arrays(scene), ITERATIONS_CROWDED if scene.crowd else ITERATIONS
    query = Query(start, goals[free], q_min, q_max, most)
    return _Search(query, arrays, _fit(arrays, query), free, "spheres", stuck, touched)


def _fit(arrays: SphereArrays, query: Query) -> SphereChecker:
    """Spheres that refuse neither the start nor a goal, all of which are free in truth."""
    checker = SphereChecker(arrays)
    for q in (query.start_rad, *query.goals_rad):
        if not checker.is_free(q):
            arrays = arrays.yield_at(q)
            checker = SphereChecker(arrays)
    return checker


def _search(
    search: _Search, scene: PlanningScene, seed: int, should_cancel: Callable[[], bool]
) -> tuple[_Search, Path | None]:
    """A path, and how it was sought at last."""
    query, checker = search.query, search.checker
    path = find_path(query, checker, seed, should_cancel)
    if path is not None or not isinstance(checker, SphereChecker):
        return search, path
    if scene.crowd and find_path(query, SphereChecker(checker.arrays.leave_alone()), seed, should_cancel) is not None:
        return search, None
    return replace(search, checker=scene, name="exact"), find_path(query, scene, seed, should_cancel)


def _time_and_check(path: Path, search: _Search, scene: PlanningScene, time_rows: TimeRows, job: Job) -> Timed | None:
    for rounded in (True, False):
        with job.stage("path"):
            rows = round_corners(path.rows_rad, search.checker) if rounded else densify(path.rows_rad, DENSE_RAD)
        if search.stuck_rad is not None:
            rows = np.vstack((densify(np.vstack((search.stuck_rad, rows[0])), DENSE_RAD), rows[1:]))
        with job.stage("timing"):
            timed = time_rows(rows)
        if scene.robot.exceeds_limits(timed.trajectory.q_rad):
            job.rejected["joint limit"] += 1
            continue
        with job.stage("check"):
            if search.stuck_rad is not None:
                if leaves_contact(timed.trajectory.q_rad, search.touched, scene):
                    return timed
                continue
            rows = thin_out(timed.trajectory.q_rad, search.arrays)
            blocked = scene.find_first_blocked(rows, CHECK_M)
        if blocked is None:
            return timed
        job.rejected[Contact(*blocked[1][0])] += 1
    return None


def thin_out(rows_rad: Array, arrays: SphereArrays) -> Array:
    """As few rows of a motion (k, n_joints) as let a point of the robot move by `CHECK_M`, or one row, between two."""
    moved = measure_steps(rows_rad, *arrays[:3], arrays.link, arrays.bounds).cumsum()
    kept: Array = rows_rad[_keep_apart(np.concatenate(((0.0,), moved, (np.inf,))), CHECK_M)]
    return kept


@njit(cache=True, error_model="numpy")
def _keep_apart(turned, apart):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    """Indices of a rising series before each that is more than `apart` from the one kept before; the first is kept."""
    kept = [0]
    for row in range(1, len(turned) - 1):
        if turned[row + 1] - turned[kept[-1]] > apart:
            kept.append(row)
    return np.array(kept)


def find_escape(start_rad: Array, touched: Sequence[Pair], scene: PlanningScene, seed: int) -> Array | None:
    """A free posture (n_joints,) reached from the start in a straight line; None when there is none."""
    rng = np.random.default_rng(seed)
    for radius in ESCAPE_RADII_RAD:
        for direction in rng.normal(size=(ESCAPE_DIRECTIONS, len(start_rad))):
            beside = start_rad + radius * direction / np.linalg.norm(direction)
            goal: Array = np.clip(beside, scene.robot.q_min_rad, scene.robot.q_max_rad)
            steps = np.linspace(0.0, 1.0, 1 + int(np.ceil(radius / ESCAPE_STEP_RAD)))[1:, None]
            if leaves_contact(start_rad + steps * (goal - start_rad), touched, scene):
                return goal
    return None


def leaves_contact(rows_rad: Array, touched: Sequence[Pair], scene: PlanningScene) -> bool:
    """Whether a motion (k, n_joints) touches only what it touched at its start, then nothing, to its end."""
    is_out = False
    for q in rows_rad:
        contacts = scene.find_contacts(q)
        if contacts and (is_out or not set(contacts) <= set(touched)):
            return False
        is_out = is_out or not contacts
    return is_out


def follow_waypoints(
    q_rad: Array, waypoints: Sequence[Pose], label: str, kinematics: Kinematics, scene: PlanningScene, job: Job
) -> Approaches | NoPlan:
    """One approach of this label from a posture (n_joints,) on straight lines through tool poses, or why there is none.

    Contacts of the first posture are tolerated until the line leaves them: a lifted entity touches its table at first.
    Corners are rounded by a few millimetres before the check, so that the arm passes without a stop.
    """
    rows, solved = [np.array(q_rad)], Differential(0, 0.0, 0.0)
    for index, waypoint in enumerate(waypoints):
        with job.stage("ik"):
            part = kinematics.solve_line(rows[-1], compute_matrix(waypoint))
        if part is None:
            job.rejected["line"] += 1
            return job.fail("NO_IK", f"The straight line to waypoint {index} leaves the workspace.")
        rows.extend(part.q_rad[1:])
        solved = combine(solved, part.solved)
    if len(waypoints) > 1:
        rounded = np.array(rows)
        for _ in range(ROUNDING_PASSES):  # 1-2-1 with the neighbours, the ends kept
            rounded = np.vstack((rounded[:1], (rounded[:-2] + 2.0 * rounded[1:-1] + rounded[2:]) / 4.0, rounded[-1:]))
        rows = list(rounded)
    with job.stage("check"):
        tolerated = set(scene.find_contacts(rows[0]))
        for q in rows[1:]:
            contacts = set(scene.find_contacts(q))
            if blocked := sorted(contacts - tolerated):
                job.rejected[Contact(*blocked[0])] += 1
                return job.fail("IN_COLLISION", f"The straight line runs into {Contact(*blocked[0])}.")
            tolerated &= contacts
    return Approaches(
        approaches=(Approach(label=label, tcp_end=waypoints[-1], line_rad=np.array(rows)),),
        timing=job.timing,
        stages=Stages(goals=(GoalPosture(label, solved),)),
    )
