"""Approaches from wanted tool poses: the posture above, the straight line down, and their contacts.

Compiled inverse kinematics screens many seeds; mink solves the nearest candidates and their lines (`kinematics`).
A touch is such a line down onto a point, as the middle of a button.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np

from phyagentos.geometry import compute_pose
from phyagentos.protocol.capabilities.targets import BASE_JOINTS
from phyagentos.protocol.sessions.trace import Contact
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.planning_scene import Pair, PlanningScene
from phyagentos.runtime.motion.poses import move_pose, point_tool_down, tilt_tool
from phyagentos.runtime.motion.requests import Approach, Approaches, Array, FindTouch, GoalPosture, NoPlan
from phyagentos.runtime.motion.robot_model import measure_tips
from phyagentos.runtime.motion.tool_bounds import find_wall

NEAR_HOME_SEEDS = 4
NEAR_HOME_SPREAD_RAD = 0.5
UNIFORM_SEEDS = 10
SAME_POSTURE_RAD = 0.05
POSTURES_PER_WAY = 2  # branches of the inverse that are worth offering for one label
TURNS_DEG = range(0, 360, 45)  # of the hand, which is longer than it is wide
TOUCH_LEANS_DEG = (0, 20, 40, 60)  # of a hand that moves on from where it touches


@dataclass(frozen=True, slots=True)
class ApproachCandidate:
    """One acceptable tool pose, and all that a motion to it means: openings of the fingers, and what may touch.

    The posture above is free at every opening up to the widest, since the fingers are opened there. The line down, and
    its end, are free from the least to the greatest of `openings_m`: those at which it is followed, and through which
    the fingers go at its end.

    Attributes:
        end: (4, 4) `world_T_tcp`; the straight line to it begins `hover_m` [m] along `back` (3,), a unit direction.
        openings_m: Of the fingers when they hold, and when they do not.
        tolerate: Pairs whose contact is intended within `tolerate_m` [m] of the end.
        site: (4, 4) pose of the held entity after a place; it falls there by `fall_m` [m] when it is let go.
        is_clear: Whether the fingers keep off what is tolerated while they are open.
    """

    label: str
    end: Array
    hover_m: float
    openings_m: tuple[float, float]
    tolerate: frozenset[Pair]
    tolerate_m: float
    site: Array | None = None
    fall_m: float = 0.0
    is_clear: bool = False
    back: tuple[float, ...] = (0.0, 0.0, 1.0)

    @property
    def start(self) -> Array:
        """(4, 4) tool pose where the line begins."""
        return move_pose(self.end, self.hover_m * np.array(self.back))

    def find_blocked(self, q_rad: Array, left_m: float, scene: PlanningScene) -> list[Pair]:
        """Pairs that must not touch in a posture (n_joints,) of the line, `left_m` before its end."""
        tolerate = self.tolerate if left_m <= self.tolerate_m else frozenset()
        blocked = scene.sweep(q_rad, *self.openings_m, tolerate)
        if self.is_clear and not blocked:
            open_m = self.openings_m[1]
            blocked = scene.sweep(q_rad, open_m, open_m)
        return blocked


class Screen:
    """Compiled inverse kinematics from start postures `seeds` (k, n_joints): here, home, near home, anywhere.

    A base begins where it stands. What was found is kept: ways that differ in their openings share tool poses.
    """

    def __init__(self, kinematics: Kinematics, q_rad: Array, home_rad: Array, seed: int) -> None:
        self._chain = chain = kinematics.chain
        rng = np.random.default_rng(seed)
        if chain.slides:
            home_rad = np.concatenate((q_rad[: len(BASE_JOINTS)], home_rad[len(BASE_JOINTS) :]))
        near = home_rad + rng.normal(0.0, NEAR_HOME_SPREAD_RAD, (NEAR_HOME_SEEDS, len(home_rad)))
        anywhere = rng.uniform(chain.q_min_rad, chain.q_max_rad, (UNIFORM_SEEDS, len(home_rad)))
        self.seeds = np.clip(np.vstack((q_rad, home_rad, near, anywhere)), chain.q_min_rad, chain.q_max_rad)
        self._found: dict[tuple[bytes, bool], Array] = {}
        self._latest_rad = self.seeds[0]

    def find_postures(self, world_T_tcp: Array, job: Job, *, anywhere: bool) -> Array:
        """Distinct postures (m, n_joints) of a tool pose, from the seeds anywhere or from the others."""
        key = world_T_tcp.tobytes(), anywhere
        if key not in self._found:
            seeds = self.seeds[-UNIFORM_SEEDS:] if anywhere else self.seeds[:-UNIFORM_SEEDS]
            self._found[key], reached = self._chain.solve_all(world_T_tcp, seeds, SAME_POSTURE_RAD)
            job.screened += len(seeds)
            job.reached += reached
        return self._found[key]

    def find_any(self, world_T_tcp: Array) -> Array | None:
        """A posture (n_joints,) of a tool pose, sought where the one before was found; None where that fails."""
        found = self._chain.solve(world_T_tcp, self._latest_rad)
        self._latest_rad = self._latest_rad if found is None else found
        return found


def find_approaches(
    ways: Sequence[ApproachCandidate],
    *,
    q_rad: Array,
    screen: Screen,
    kinematics: Kinematics,
    scene: PlanningScene,
    job: Job,
    count: int,
) -> list[Approach]:
    """At most `count` approaches, the nearest to `q_rad` in joint space first; reasons of rejection go to the job.

    Contacts are checked in that order, so that no more postures are checked than are wanted. Seeds anywhere serve the
    ways of which no posture above was free.
    """
    found: list[Approach] = []
    taken, reached = Counter[str](), set[int]()
    with job.stage("check"):
        left = {index for index, way in enumerate(ways) if not _is_closed(way, screen, scene, job)}
    closed = set[int]()
    for anywhere in (False, True) if left else ():
        with job.stage("ik"):
            hovers = []
            for index in sorted(left - closed):
                rows = screen.find_postures(ways[index].start, job, anywhere=anywhere)
                away = np.linalg.norm(rows - q_rad, axis=1).tolist()
                hovers += [(*each, index) for each in zip(away, rows, strict=True)]
        reached |= {index for _, _, index in hovers}
        for _, q, index in sorted(hovers, key=itemgetter(0)):
            way = ways[index]
            if index in closed or taken[way.label] == POSTURES_PER_WAY:
                continue
            with job.stage("check"):
                reason, is_closed = _find_obstruction(way, q, kinematics, scene)
            closed |= {index} if is_closed else set()
            if reason:
                job.rejected[reason] += 1
                continue
            left.discard(index)
            approach = _find_line(way, q, kinematics, scene, job)
            if approach is not None:
                taken[way.label] += 1
                found.append(approach)
            if len(found) == count:
                return found
    if unreached := left - reached:
        job.rejected["ik"] += len(unreached)
    return found


def _is_closed(way: ApproachCandidate, screen: Screen, scene: PlanningScene, job: Job) -> bool:
    """Whether the tool is out of its bounds or touches something at the end of a way, whatever the arm's posture."""
    bounds, tool = scene.robot.bounds, scene.robot.tool
    walls = find_wall(bounds, way.end[:3, 3]) or find_wall(bounds, way.start[:3, 3])
    end = None if walls else screen.find_any(way.end)
    pairs = [] if end is None else way.find_blocked(end, 0.0, scene)
    closed = [(tool, walls)] if walls else [pair for pair in pairs if scene.is_of_tool_pose(pair)]
    job.rejected.update(Contact(*pair) for pair in closed[:1])
    return bool(closed)


def _find_obstruction(
    way: ApproachCandidate, q_rad: Array, kinematics: Kinematics, scene: PlanningScene
) -> tuple[str | Contact, bool]:
    """Why a posture above a way is not free, or its end is not; and whether that is so for every posture."""
    blocked = scene.sweep(q_rad, way.openings_m[0], scene.robot.profile.gripper.max_width_m)
    if not blocked:
        end = kinematics.chain.solve(way.end, q_rad)
        if end is None:
            return "line", False
        blocked = way.find_blocked(end, 0.0, scene)
    return Contact(*blocked[0]) if blocked else "", any(map(scene.is_of_tool_pose, blocked))


def _find_line(
    way: ApproachCandidate, q_rad: Array, kinematics: Kinematics, scene: PlanningScene, job: Job
) -> Approach | None:
    """The approach whose line begins near a posture (n_joints,); None where that is cut off or touches something."""
    with job.stage("ik"):
        start = kinematics.solve(way.start, q_rad, kinematics.polished)
        found = None if start is None else kinematics.solve_line(start.q_rad, way.end)
    if start is None or found is None:
        job.rejected["line"] += 1
        return None
    line = found.q_rad
    with job.stage("check"):
        for q, distance_m in zip(line, np.linspace(way.hover_m, 0.0, len(line)), strict=True):
            blocked = way.find_blocked(q, distance_m, scene)
            if blocked:
                job.rejected[Contact(*blocked[0])] += 1
                return None
    job.goals.append(GoalPosture(way.label, found.solved, start.solved))
    return Approach(
        label=way.label,
        tcp_end=compute_pose(way.end),
        line_rad=line,
        site=None if way.site is None else compute_pose(way.site),
        release_m=way.openings_m[1],
        fall_m=way.fall_m,
    )


def find_touch(
    request: FindTouch,
    kinematics: Kinematics,
    scene: PlanningScene,
    job: Job,
    lead_on: Callable[[Approach], Approaches | NoPlan],
) -> Approaches | NoPlan:
    """Ways that end with the fingertips at the point, the nearest first; those that lead on, if any does."""
    first: list[Approach] = []
    screen = Screen(kinematics, request.q_rad, scene.robot.home_rad, request.seed)
    for lean_deg in TOUCH_LEANS_DEG if request.moves else (0,):
        ways = list(_iter_touches(request, measure_tips(scene.robot), lean_deg))
        found = find_approaches(
            ways,
            q_rad=request.q_rad,
            screen=screen,
            kinematics=kinematics,
            scene=scene,
            job=job,
            count=len(ways) * POSTURES_PER_WAY if request.moves else request.count,
        )
        leading = [each for each in found if not isinstance(lead_on(each), NoPlan)] if request.moves else found
        first = first or found
        if leading:
            return Approaches(approaches=tuple(leading[: request.count]), timing=job.timing, stages=job.stages)
    if first:
        return Approaches(approaches=tuple(first[: request.count]), timing=job.timing, stages=job.stages)
    return job.fail("NO_IK", f"No straight way down brings the fingertips onto {request.object}.")


def _iter_touches(request: FindTouch, tips_m: float, lean_deg: int) -> Iterator[ApproachCandidate]:
    x, y, z = request.at_m
    for degrees in TURNS_DEG:
        end = point_tool_down(np.radians(degrees), np.array((x, y, z + tips_m)))
        if lean_deg:
            end = tilt_tool(end, np.radians(lean_deg))
            end[:3, 3] = np.array(request.at_m) - tips_m * end[:3, 2]
        yield ApproachCandidate(
            label=f"touch+{degrees:03d}" + (f".lean{lean_deg}" if lean_deg else ""),
            end=end,
            hover_m=request.hover_m,
            openings_m=(request.width_m, request.width_m),
            tolerate=frozenset(),
            tolerate_m=0.0,
        )
