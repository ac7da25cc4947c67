"""Timing of a path within the joint limits, with toppra.

A natural cubic spline through the rows is traversed as fast as the limits allow. It is stretched until its finite
differences respect them too, and to whole control periods, so that the last command ends at rest.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.motion.calls import Solver, count_call
from phyagentos.runtime.motion.requests import Array, TimeScaling, Trajectory
from phyagentos.runtime.motion.without_plots import without_plots

with without_plots():
    import toppra
    from toppra import algorithm, constraint

VELOCITY_SCALE = 0.9  # of the datasheet's limits; the rest is for the controller
ACCELERATION_SCALE = 0.7  # toppra exceeds its limit by some per cent between grid points
FINITE_DIFFERENCE_SCALE = 0.98  # the guard differentiates too, and refuses at 1
DUPLICATE_RAD = 1e-4
GRID_SHARE, GRID_MIN, GRID_MAX = 3, 24, 300  # points of the grid for a row, and in all
REFINEMENTS = 1.0, 1.4, 2.0  # of the grid: toppra's linear programs fail at a rare point and stop the motion there
STOP_SHARE = 1e-3  # of the greatest speed; a motion from rest to rest is faster at all points between

logging.getLogger("toppra").setLevel(logging.ERROR)


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Limits of a trajectory (n_joints,) and the periods it is made for.

    `steps_per_command` rows of `step_s` [s] make one control period.
    """

    velocity_rad_s: Array
    acceleration_rad_s2: Array
    step_s: float
    steps_per_command: int

    @classmethod
    def from_profile(cls, profile: TargetProfile) -> "JointLimits":
        """The datasheet's limits."""
        return cls(
            np.array(profile.arm.velocity_rad_s),
            np.array(profile.arm.acceleration_rad_s2),
            profile.physics_step_s,
            round(profile.control_period_s / profile.physics_step_s),
        )

    def scale(self, velocity: float, acceleration: float) -> "JointLimits":
        """Both limits times a factor each."""
        qd, qdd = velocity * self.velocity_rad_s, acceleration * self.acceleration_rad_s2
        return replace(self, velocity_rad_s=qd, acceleration_rad_s2=qdd)


def drop_duplicates(rows_rad: Array, spacing_rad: float = DUPLICATE_RAD) -> Array:
    """Rows at least `spacing_rad` [rad] from their predecessor in some joint; the last row always stays.

    A path that never moves that far becomes its last row alone.
    """
    keep = [0]
    for index in range(1, len(rows_rad)):
        if np.abs(rows_rad[index] - rows_rad[keep[-1]]).max() > spacing_rad:
            keep.append(index)
    if keep[-1] != len(rows_rad) - 1:
        keep.pop()
        keep.append(len(rows_rad) - 1)
    return rows_rad[keep]


def fit_spline(rows_rad: Array) -> CubicSpline:
    """The natural cubic spline through rows (k, n_joints), k >= 2, over their normalised chord length."""
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(rows_rad, axis=0), axis=1))))
    return CubicSpline(along / along[-1], rows_rad, bc_type="natural")


@dataclass(frozen=True, slots=True)
class Timed:
    """A timed motion and its solver."""

    trajectory: Trajectory
    scaling: TimeScaling

    @classmethod
    def by(cls, solver: str, status: str, trajectory: Trajectory) -> "Timed":
        """The motion of a solver."""
        return cls(trajectory, TimeScaling(solver, status, round(trajectory.duration_s, 4)))


def time_path(rows_rad: Array, limits: JointLimits) -> Timed:
    """The fastest motion through rows (k, n_joints) within the limits, from rest to rest.

    Rows closer than 1e-4 rad are dropped; a path that hardly moves takes one control period.
    """
    rows = drop_duplicates(rows_rad)
    if len(rows) < 2:
        return Timed.by("quintic", "too short for toppra", _creep(rows_rad[0], rows_rad[-1], limits))
    path, problem = _run_toppra(rows, limits)
    status = problem.return_code.name
    if problem.return_code is not algorithm.algorithm.ParameterizationReturnCode.Ok:
        return Timed.by("quintic", f"toppra: {status}", _creep(rows_rad[0], rows_rad[-1], limits))
    knots, speeds = problem.gridpoints, problem.sd_vec

    def evaluate(times_s: Array) -> tuple[Array, Array]:
        s, speed = compute_progress(knots, speeds, times_s)
        return path(s), path(s, 1) * speed[:, None]

    motion = sample_within_limits(evaluate, float(end_knots(knots, speeds)[-1]), rows[0], rows[-1], limits)
    return Timed.by("toppra", status, motion)


def compute_progress(knots: Array, speeds: Array, times_s: Array) -> tuple[Array, Array]:
    """Path parameter and its speed at times (n,) [s], with constant acceleration between knots (k,).

    `speeds` (k,) are those of the parameter at the knots [1/s]; time 0 is the first knot.
    """
    ends_s = end_knots(knots, speeds)
    k = np.clip(np.searchsorted(ends_s, times_s, side="right") - 1, 0, len(knots) - 2)
    acceleration = (np.diff(speeds**2) / (2.0 * np.diff(knots)))[k]
    dt = times_s - ends_s[k]
    return knots[k] + dt * (speeds[k] + 0.5 * dt * acceleration), speeds[k] + dt * acceleration


def end_knots(knots: Array, speeds: Array) -> Array:
    """(k,) times at which the knots are reached [s]."""
    return np.concatenate(([0.0], np.cumsum(2.0 * np.diff(knots) / (speeds[1:] + speeds[:-1]))))


def sample_within_limits(
    evaluate: Callable[[Array], tuple[Array, Array]],
    duration_s: float,
    start_rad: Array,
    end_rad: Array,
    limits: JointLimits,
) -> Trajectory:
    """Sample a motion from rest to rest, slowed down until its finite differences respect the limits.

    `evaluate` gives positions and velocities (k, n_joints) at times (k,) in 0..duration [s]; the last posture
    `end_rad` (n_joints,) is reached exactly.
    """
    commands = int(np.ceil(duration_s / (limits.step_s * limits.steps_per_command) - 1e-9))
    while True:
        n = commands * limits.steps_per_command
        slowdown = max(1.0, n * limits.step_s / duration_s)
        q, qd = evaluate(np.arange(1.0, n + 1.0) * (limits.step_s / slowdown))
        qd /= slowdown
        q[-1], qd[-1] = end_rad, 0.0
        excess = compute_excess(start_rad, q, qd, limits)
        if excess <= FINITE_DIFFERENCE_SCALE:
            return Trajectory(q_rad=q, qd_rad_s=qd, step_s=limits.step_s)
        commands = max(commands + 1, int(np.ceil(commands * np.sqrt(excess / FINITE_DIFFERENCE_SCALE))))


def compute_excess(start_rad: Array, q_rad: Array, qd_rad_s: Array, limits: JointLimits) -> float:
    """Largest ratio of a finite-difference velocity or acceleration to its limit, starting from rest."""
    dt, still = limits.step_s, np.zeros_like(start_rad)
    moved, asked = np.diff(np.vstack((start_rad, start_rad, q_rad)), axis=0) / dt, np.vstack((still, qd_rad_s))
    speeds = np.maximum(np.abs(moved[1:]), np.abs(qd_rad_s)) / limits.velocity_rad_s
    changes = np.maximum(*(np.abs(np.diff(each, axis=0)) for each in (moved, asked))) / (
        dt * limits.acceleration_rad_s2
    )
    return float(max(speeds.max(), changes.max()))


def _creep(start_rad: Array, end_rad: Array, limits: JointLimits) -> Trajectory:
    """A motion too small for toppra: a quintic over one control period, or as many as it takes."""
    period_s = limits.step_s * limits.steps_per_command

    def evaluate(times_s: Array) -> tuple[Array, Array]:
        t = np.minimum(times_s / period_s, 1.0)[:, None]
        s, ds = 10 * t**3 - 15 * t**4 + 6 * t**5, 30 * t**2 - 60 * t**3 + 30 * t**4
        return start_rad + s * (end_rad - start_rad), ds / period_s * (end_rad - start_rad)

    return sample_within_limits(evaluate, period_s, start_rad, end_rad, limits)


def _run_toppra(rows: Array, limits: JointLimits) -> tuple[toppra.SplineInterpolator, algorithm.ParameterizationData]:
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(rows, axis=0), axis=1))))
    path = toppra.SplineInterpolator(along / along[-1], rows, bc_type="natural")
    limited = list(_constrain(tuple(limits.velocity_rad_s.tolist()), tuple(limits.acceleration_rad_s2.tolist())))
    points = np.clip(GRID_SHARE * len(rows), GRID_MIN, GRID_MAX)
    for refinement in REFINEMENTS:
        solver = algorithm.TOPPRA(
            limited, path, gridpoints=np.linspace(0.0, 1.0, int(refinement * points)), solver_wrapper="seidel"
        )
        count_call(Solver.TOPPRA)
        solver.compute_parameterization(0.0, 0.0)
        speeds = solver.problem_data.sd_vec
        if speeds is None or speeds[1:-1].min() > STOP_SHARE * speeds.max():
            break
    return path, solver.problem_data


@lru_cache(maxsize=16)
def _constrain(velocity: tuple[float, ...], acceleration: tuple[float, ...]) -> tuple[constraint.Constraint, ...]:
    """Limits [rad/s], [rad/s^2] as toppra takes them; kept, since to make them takes longer than to use them."""
    fastest, hardest = VELOCITY_SCALE * np.array(velocity), ACCELERATION_SCALE * np.array(acceleration)
    return (
        constraint.JointVelocityConstraint(np.column_stack((-fastest, fastest))),
        constraint.JointAccelerationConstraint(
            np.column_stack((-hardest, hardest)), discretization_scheme=constraint.DiscretizationType.Interpolation
        ),
    )
