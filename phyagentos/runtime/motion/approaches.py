"""Approaches from wanted tool poses: the posture above, the straight line down, and their contacts.

Compiled inverse kinematics screens many seeds; mink polishes the nearest candidates and solves their lines.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phyagentos.geometry import compute_pose
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import POLISHED, Kinematics
from phyagentos.runtime.motion.planning_scene import Pair, PlanningScene, name_pair
from phyagentos.runtime.motion.poses import raise_pose
from phyagentos.runtime.motion.requests import Approach, Array, GoalPosture

NEAR_HOME_SEEDS = 4
NEAR_HOME_SPREAD_RAD = 0.5
UNIFORM_SEEDS = 10
SAME_POSTURE_RAD = 0.05
POSTURES_PER_WAY = 2  # branches of the inverse that are worth offering for one label


@dataclass(frozen=True, slots=True)
class Way:
    """One acceptable tool pose.

    Attributes:
        end: (4, 4) `world_T_tcp`.
        hover_m: Height above `end` at which the straight line begins [m].
        tolerate: Pairs whose contact is intended within `tolerate_m` [m] of the end.
        site: Pose of the held entity after a place.
    """

    label: str
    end: Array
    hover_m: float
    tolerate: frozenset[Pair]
    tolerate_m: float
    site: Pose | None = None


@dataclass(frozen=True, slots=True)
class _Hover:
    way: Way
    q_rad: Array


def draw_seeds(kinematics: Kinematics, q_rad: Array, home_rad: Array, seed: int) -> list[Array]:
    """Start postures for the inverse: here, home, near home, anywhere; in that order."""
    chain = kinematics.chain
    rng = np.random.default_rng(seed)
    near = home_rad + rng.normal(0.0, NEAR_HOME_SPREAD_RAD, (NEAR_HOME_SEEDS, len(home_rad)))
    anywhere = rng.uniform(chain.q_min_rad, chain.q_max_rad, (UNIFORM_SEEDS, len(home_rad)))
    return [np.clip(q, chain.q_min_rad, chain.q_max_rad) for q in (q_rad, home_rad, *near, *anywhere)]


def find_approaches(
    ways: Sequence[Way],
    *,
    q_rad: Array,
    seeds: Sequence[Array],
    kinematics: Kinematics,
    scene: PlanningScene,
    job: Job,
    count: int,
) -> list[Approach]:
    """At most `count` approaches, the nearest to `q_rad` in joint space first; reasons of death go to the job."""
    with job.stage("ik"):
        hovers = [hover for way in ways for hover in _find_hovers(way, seeds, kinematics, scene, job)]
    hovers.sort(key=lambda hover: float(np.linalg.norm(hover.q_rad - q_rad)))
    found: list[Approach] = []
    taken: Counter[str] = Counter()
    for hover in hovers:
        if len(found) == count:
            break
        way = hover.way
        if taken[way.label] < POSTURES_PER_WAY and (line := _find_line(hover, kinematics, scene, job)) is not None:
            taken[way.label] += 1
            found.append(Approach(label=way.label, tcp_end=compute_pose(way.end), line_rad=line, site=way.site))
    return found


def _find_hovers(
    way: Way, seeds: Sequence[Array], kinematics: Kinematics, scene: PlanningScene, job: Job
) -> list[_Hover]:
    """Postures above a way that are free and whose way down looks open at its end."""
    job.checkpoint()
    target = raise_pose(way.end, way.hover_m)
    hovers: list[_Hover] = []
    reached = False
    for index, start in enumerate(seeds):
        if index >= 2 + NEAR_HOME_SEEDS and hovers:
            break
        q = kinematics.chain.solve(target, start)
        job.screened += 1
        if q is None:
            continue
        reached = True
        job.reached += 1
        if any(np.abs(q - other.q_rad).max() < SAME_POSTURE_RAD for other in hovers):
            continue
        blocked = scene.find_contacts(q)
        if not blocked:
            end = kinematics.chain.solve(way.end, q)
            if end is None:
                job.rejected["line"] += 1
                continue
            blocked = [pair for pair in scene.find_contacts(end) if pair not in way.tolerate]
        if blocked:
            job.rejected[name_pair(blocked[0])] += 1
            if any(scene.is_of_tool_pose(pair) for pair in blocked):
                break
            continue
        hovers.append(_Hover(way, q))
    if not reached:
        job.rejected["ik"] += 1
    return hovers


def _find_line(hover: _Hover, kinematics: Kinematics, scene: PlanningScene, job: Job) -> Array | None:
    way = hover.way
    with job.stage("ik"):
        start = kinematics.solve(raise_pose(way.end, way.hover_m), hover.q_rad, POLISHED)
        found = None if start is None else kinematics.solve_line(start.q_rad, way.end)
    if start is None or found is None:
        job.rejected["line"] += 1
        return None
    line = found.q_rad
    with job.stage("check"):
        left_m = np.linspace(way.hover_m, 0.0, len(line))
        for q, distance_m in zip(line, left_m, strict=True):
            blocked = [
                pair for pair in scene.find_contacts(q) if distance_m > way.tolerate_m or pair not in way.tolerate
            ]
            if blocked:
                job.rejected[name_pair(blocked[0])] += 1
                return None
    job.goals.append(GoalPosture(way.label, found.solved, start.solved))
    return line
