"""OMPL's RRT-Connect on the exact model, where the sphere model finds no path."""

from collections.abc import Callable

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from phyagentos.runtime.motion.path import RANGE_RAD, SHORTCUTS, Checker, Path, Query, cut, find_straight, measure
from phyagentos.runtime.motion.requests import Array


class _EdgeValidator(ob.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: ob.SpaceInformation, checker: Checker) -> None:
        super().__init__(information)
        self._checker, self._n = checker, information.getStateDimension()

    def checkMotion(self, first: ob.State, second: ob.State, *_: object) -> bool:  # noqa: N802 - OMPL's name
        n = self._n
        return bool(self._checker.edge_is_free(np.array(first[0:n]), np.array(second[0:n])))


def find_exact_path(query: Query, checker: Checker, seed: int, should_cancel: Callable[[], bool]) -> Path | None:
    """The direct way, else one search whose corners are shortened; None where it finds none in its iterations."""
    if straight := find_straight(query, checker):
        return straight
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(1 + seed % (2**31 - 2))
    n = len(query.start_rad)
    space, bounds = ob.RealVectorStateSpace(n), ob.RealVectorBounds(n)
    for joint in range(n):
        bounds.setLow(joint, float(query.q_min_rad[joint]))
        bounds.setHigh(joint, float(query.q_max_rad[joint]))
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: checker.is_free(np.array(state[0:n])))

    validator = _EdgeValidator(information, checker)
    information.setMotionValidator(validator)
    information.setup()
    problem = ob.ProblemDefinition(information)
    problem.addStartState(_allocate(information, query.start_rad))
    goals = ob.GoalStates(information)
    for goal in query.goals_rad:
        goals.addState(_allocate(information, goal))
    problem.setGoal(goals)
    planner = og.RRTConnect(information)
    planner.setRange(RANGE_RAD)
    planner.setProblemDefinition(problem)
    planner.setup()
    iterations = 0

    def is_over() -> bool:
        nonlocal iterations
        iterations += 1
        return iterations > query.iterations or bool(should_cancel())

    planner.solve(ob.PlannerTerminationCondition(is_over))
    if not problem.hasExactSolution():
        return None
    rows = np.array([state[0:n] for state in problem.getSolutionPath().getStates()])
    goal = query.find_goal(rows[-1])
    rows[0], rows[-1] = query.start_rad, query.goals_rad[goal]
    rows = shorten(rows, checker, query.weights, np.random.default_rng(seed))
    return Path(rows, goal, iterations, "RRT-Connect on the exact model")


def shorten(rows_rad: Array, checker: Checker, weights: Array, rng: np.random.Generator) -> Array:
    """Replace random parts of a path (k, n_joints) by straight motions where these are free."""
    rows, along = rows_rad, measure(rows_rad, weights)
    for fractions in np.sort(rng.random((SHORTCUTS, 2)), axis=1):
        if len(rows) < 3:
            break
        i, j, a, b = cut(rows, along, *(fractions * along[-1]), weights)
        if i < j and checker.edge_is_free(a, b):
            rows = np.concatenate((rows[:i], a[None], b[None], rows[j:]))
            along = measure(rows, weights)
    return rows


def _allocate(information: ob.SpaceInformation, q_rad: Array) -> ob.State:
    state = information.allocState()
    state[0 : len(q_rad)] = q_rad.tolist()
    return state
