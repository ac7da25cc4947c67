"""A peer of motion planning: OMPL's RRT-Connect and its simplifier, where each validity of a state is a call of MuJoCo.

It gets what our planner gets: joints and limits, the planning model with its allowed collisions, all goals as roots,
the direct motion first, resolution, range and budget, then the same rounding, timing and exact check, as often.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import process_time

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.motion.chain import build_chain
from phyagentos.runtime.motion.moves import ATTEMPTS, CHECK_M, DENSE_RAD, thin_out
from phyagentos.runtime.motion.path import ITERATIONS, RANGE_RAD, compute_length, densify, round_corners
from phyagentos.runtime.motion.planning_scene import PlanningScene, PlanningScenes
from phyagentos.runtime.motion.requests import Array, PlanMove
from phyagentos.runtime.motion.robot_model import RobotModel
from phyagentos.runtime.motion.sphere_model import SphereModel
from phyagentos.runtime.motion.timing import JointLimits, Timed, time_path
from phyagentos.runtime.motion.transport import CarryConstraints, time_carry

RESOLUTION_RAD = 0.03  # of an edge, as our checks take it


@dataclass(slots=True)
class Found:
    """What the peer found: length of its path [rad], if any, and CPU time [ms] by stage."""

    length_rad: float | None = None
    ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what is spent inside."""
        began_s = process_time()
        try:
            yield
        finally:
            self.ms[name] = self.ms.get(name, 0.0) + 1e3 * (process_time() - began_s)


class OmplPeer:
    """The peer for one robot."""

    def __init__(self, robot: RobotModel, profile: TargetProfile) -> None:
        ou.setLogLevel(ou.LogLevel.LOG_NONE)
        self._robot, self._scenes, self._chain = robot, PlanningScenes(robot), build_chain(robot)
        self._spheres = SphereModel(robot, self._chain)
        self._limits = JointLimits.from_profile(profile)

    def answer(self, move: PlanMove) -> Found:
        """A verified, timed motion, or none."""
        found = Found()
        with found.stage("model"):
            scene = self._scenes.get_scene(move.world, move.payload, move.ignore)
            if move.payload is None and move.width_m is not None:
                scene.spread_fingers(move.width_m, move.width_m)
            goals = [goal for goal in np.atleast_2d(move.goals_rad) if scene.is_free(goal)]
            start = np.clip(move.q_rad, self._robot.q_min_rad, self._robot.q_max_rad)
        if not goals or not scene.is_free(start):
            return found
        for attempt in range(ATTEMPTS):
            with found.stage("path"):
                rows = self._search(scene, start, goals, move.seed + attempt)
            if rows is None:
                break
            if self._is_verified(rows, move, scene, found):
                found.length_rad = compute_length(rows)
                break
        return found

    def _search(self, scene: PlanningScene, start: Array, goals: list[Array], seed: int) -> Array | None:
        """Corners (k, n_joints) of a simplified path, or None."""
        ou.RNG.setSeed(1 + seed % (2**31 - 2))
        n = len(start)
        space, bounds = ob.RealVectorStateSpace(n), ob.RealVectorBounds(n)
        for joint in range(n):
            bounds.setLow(joint, float(self._robot.q_min_rad[joint]))
            bounds.setHigh(joint, float(self._robot.q_max_rad[joint]))
        space.setBounds(bounds)
        information = ob.SpaceInformation(space)
        information.setStateValidityChecker(lambda state: scene.is_free(np.array(state[0:n])))
        information.setStateValidityCheckingResolution(RESOLUTION_RAD / space.getMaximumExtent())
        information.setup()

        def make(q_rad: Array) -> ob.State:
            state = information.allocState()
            state[0:n] = q_rad.tolist()
            return state

        for goal in sorted(goals, key=lambda goal: float(np.linalg.norm(goal - start))):
            if information.checkMotion(make(start), make(goal)):
                return np.array((start, goal))
        problem, roots = ob.ProblemDefinition(information), ob.GoalStates(information)
        problem.addStartState(make(start))
        for goal in goals:
            roots.addState(make(goal))
        problem.setGoal(roots)
        planner = og.RRTConnect(information)
        planner.setRange(RANGE_RAD)
        planner.setProblemDefinition(problem)
        planner.setup()
        left = iter(range(ITERATIONS))
        planner.solve(ob.PlannerTerminationCondition(lambda: next(left, None) is None))
        if not problem.hasExactSolution():
            return None
        path, simplifier = problem.getSolutionPath(), og.PathSimplifier(information)
        simplifier.reduceVertices(path)
        simplifier.partialShortcutPath(path)
        simplifier.ropeShortcutPath(path)  # as short as by `simplifyMax`, in a third of its time
        return np.array([state[0:n] for state in path.getStates()])

    def _is_verified(self, rows: Array, move: PlanMove, scene: PlanningScene, found: Found) -> bool:
        for rounded in (True, False):
            with found.stage("path"):
                corners = round_corners(rows, scene) if rounded else densify(rows, DENSE_RAD)
            with found.stage("timing"):
                timed = self._time(corners, move)
            with found.stage("check"):
                checked = thin_out(timed.trajectory.q_rad, self._spheres.build_arrays(scene))
                if scene.find_first_blocked(checked, CHECK_M) is None:
                    return True
        return False

    def _time(self, rows: Array, move: PlanMove) -> Timed:
        limits = self._limits.scale(move.speed, move.speed**2)
        if move.payload is None or move.payload.load is None:
            return time_path(rows, limits)
        return time_carry(rows, limits, self._chain, CarryConstraints(move.payload.load))
