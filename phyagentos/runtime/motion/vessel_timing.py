"""Timing for an open filled vessel: as fast as its contents allow, shaped with casadi.

Liquid sees the apparent gravity f = p'' + g e_z and spills when f leans too far from the vessel's axis n. Only the
progress s(t) along the path is optimised: least time, rest at both ends, joint limits, |f - (n.f) n| <= tan(tilt) n.f.
In b = s'^2 this is a convex program; s, s', s'' over free time bounds jerk exactly, but failed in half of the trials.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import msgspec
import numpy as np
from scipy.interpolate import CubicSpline

from phyagentos.runtime.motion.chain import Chain
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.requests import Array, Motion, NoPlan, ShapeTransport, Stages, Trajectory
from phyagentos.runtime.motion.timing import (
    ACCELERATION_SCALE,
    VELOCITY_SCALE,
    JointLimits,
    compute_progress,
    drop_duplicates,
    end_knots,
    fit_spline,
    sample_within_limits,
    time_path,
)

Evaluate = Callable[[Array], tuple[Array, Array]]

GRAVITY_M_S2 = 9.81
INTERVALS = 60
GRID = 121  # samples of the path that its derivatives are interpolated over
SPACING_RAD = 0.02  # between waypoints; closer ones come from a sampled trajectory and only add noise
TILT_MARGIN = 0.95  # the constraint holds at the knots; between them the tilt may be a little larger
SMOOTHNESS = 1e-3  # weight of squared changes of s'' against the duration
RAMP_S = 0.1  # over which acceleration builds up
SLOWDOWN = 1.03
MAX_ITERATIONS = 200


@dataclass(frozen=True, slots=True)
class _Geometry:
    """A path over its parameter s in 0..1: joint positions, tool centre point [m], world axis of the vessel."""

    q: CubicSpline
    p: CubicSpline
    n: CubicSpline


@dataclass(frozen=True, slots=True)
class _Shaped:
    """A motion as a function of time, its duration, and the result of ipopt."""

    evaluate: Evaluate
    duration_s: float
    status: str
    iterations: int


def shape_transport(request: ShapeTransport, chain: Chain, limits: JointLimits, job: Job) -> Motion | NoPlan:
    """The timed motion; its stages hold the worst apparent tilt, shaped and unshaped."""
    rows = drop_duplicates(np.asarray(request.waypoints_rad, dtype=float), SPACING_RAD)
    start = chain.compute_tcp(rows[0])
    axis_tcp = start[:3, :3].T @ np.array((0.0, 0.0, 1.0))
    with job.stage("timing"):
        timed = time_path(rows, limits)
        plain = timed.trajectory
        plain_tilt = compute_worst_tilt(plain, rows[0], chain, axis_tcp)
    unshaped = msgspec.structs.replace(
        timed.scaling,
        worst_tilt_rad=round(plain_tilt, 5),
        unshaped_worst_tilt_rad=round(plain_tilt, 5),
        unshaped_duration_s=timed.scaling.duration_s,
    )
    if request.method == "toppra" or len(rows) < 2:
        return Motion(trajectory=plain, goal=0, timing=job.timing, stages=Stages(scaling=unshaped))
    with job.stage("shape"):
        geometry = _describe(rows, chain, axis_tcp)
        lean = float(np.arccos(np.clip(geometry.n(np.linspace(0.0, 1.0, GRID))[:, 2].min(), -1.0, 1.0)))
        if lean >= TILT_MARGIN * request.tilt_max_rad:
            return job.fail("TILT", f"The path itself tilts the vessel by {lean:.3f} rad of {request.tilt_max_rad}.")
        shaped = _optimise(geometry, request.tilt_max_rad, limits, plain.duration_s)
        trajectory, tilt = _slow_until_level(
            shaped.evaluate,
            shaped.duration_s,
            rows,
            limits,
            request.tilt_max_rad,
            lambda t: compute_worst_tilt(t, rows[0], chain, axis_tcp),
        )
    scaling = msgspec.structs.replace(
        unshaped,
        solver="casadi",
        status=shaped.status,
        duration_s=round(trajectory.duration_s, 4),
        solver_iterations=shaped.iterations,
        worst_tilt_rad=round(tilt, 5),
    )
    return Motion(trajectory=trajectory, goal=0, timing=job.timing, stages=Stages(scaling=scaling))


def compute_worst_tilt(trajectory: Trajectory, start_rad: Array, chain: Chain, axis_tcp: Array) -> float:
    """Largest angle between the vessel's axis and the apparent gravity over a trajectory from rest [rad].

    `start_rad` (n_joints,) precedes the trajectory; `axis_tcp` (3,) is the vessel's axis in the tool frame.
    """
    poses = chain.compute_tcp_path(np.vstack((start_rad, start_rad, trajectory.q_rad, trajectory.q_rad[-1:])))
    f = np.diff(poses[:, :3, 3], n=2, axis=0) / trajectory.step_s**2 + np.array((0.0, 0.0, GRAVITY_M_S2))
    n = poses[1:-1, :3, :3] @ axis_tcp
    lateral = np.linalg.norm(np.cross(n, f), axis=1)
    return float(np.arctan2(lateral, np.einsum("ij,ij->i", n, f)).max())


def _describe(rows: Array, chain: Chain, axis_tcp: Array) -> _Geometry:
    s = np.linspace(0.0, 1.0, GRID)
    q = fit_spline(rows)
    poses = chain.compute_tcp_path(q(s))
    return _Geometry(q=q, p=CubicSpline(s, poses[:, :3, 3]), n=CubicSpline(s, poses[:, :3, :3] @ axis_tcp))


def _optimise(geometry: _Geometry, tilt_max_rad: float, limits: JointLimits, fastest_s: float) -> _Shaped:
    """Solve for b = s'^2 at knots of the path; s'' = b'/2 is constant between them, in units of `fastest_s`."""
    knots = (1.0 - np.cos(np.linspace(0.0, np.pi, INTERVALS + 1))) / 2.0  # denser where it starts and stops
    h = ca.DM(np.diff(knots))
    problem = ca.Opti()
    inner = problem.variable(INTERVALS - 1)
    b = ca.vertcat(0.0, inner, 0.0)
    a = (b[1:] - b[:-1]) / (2.0 * h)
    time = ca.sum1(2.0 * h / (ca.sqrt(b[1:] + 1e-12) + ca.sqrt(b[:-1] + 1e-12)))
    problem.minimize(time + SMOOTHNESS * ca.sumsqr(a[1:] - a[:-1]))
    problem.subject_to(inner >= 1e-6)
    b_both, a_both = ca.vertcat(b[:-1], b[1:]), ca.vertcat(a, a)  # at both ends of each interval
    s = np.concatenate((knots[:-1], knots[1:]))
    q1, q2 = geometry.q(s, 1), geometry.q(s, 2)
    velocity = VELOCITY_SCALE * fastest_s * limits.velocity_rad_s
    fastest = (velocity / np.maximum(np.abs(q1), 1e-9)) ** 2
    problem.subject_to(b_both <= ca.DM(fastest.min(axis=1)))
    acceleration = ACCELERATION_SCALE * fastest_s**2 * limits.acceleration_rad_s2
    for joint, bound in enumerate(acceleration.tolist()):
        problem.subject_to(problem.bounded(-bound, ca.DM(q2[:, joint]) * b_both + ca.DM(q1[:, joint]) * a_both, bound))
    unit = 1.0 / (GRAVITY_M_S2 * fastest_s**2)
    p1, p2, n = ca.DM(unit * geometry.p(s, 1)), ca.DM(unit * geometry.p(s, 2)), ca.DM(geometry.n(s))
    f = ca.horzcat(*(p2[:, k] * b_both + p1[:, k] * a_both + (k == 2) for k in range(3)))  # f / g, (2 k, 3)
    along = ca.sum2(f * n)
    lateral = f - ca.repmat(along, 1, 3) * n
    problem.subject_to(along >= 0.1)
    problem.subject_to(ca.sum2(lateral**2) <= (float(np.tan(TILT_MARGIN * tilt_max_rad)) * along) ** 2)
    problem.set_initial(inner, 0.1 * knots[1:-1] * (1.0 - knots[1:-1]))
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "max_iter": MAX_ITERATIONS})
    try:
        solution = problem.solve()
        values = np.clip(np.ravel(solution.value(b)), 0.0, None)
    except RuntimeError:  # casadi's word for "did not converge": the last iterate, slowed down, is still a motion
        values = np.clip(np.ravel(problem.debug.value(b)), 1e-6, None)
        values[[0, -1]] = 0.0
    evaluate, duration_s = _follow(geometry.q, knots, values, fastest_s, limits.step_s)
    stats = problem.stats()
    return _Shaped(evaluate, duration_s, str(stats["return_status"]), int(stats["iter_count"]))


def _follow(q: CubicSpline, knots: Array, b: Array, unit_s: float, step_s: float) -> tuple[Evaluate, float]:
    """The motion with b = s'^2 at the knots, its progress averaged over a window so that acceleration never steps."""
    speeds = np.sqrt(b) / unit_s
    s, _ = compute_progress(knots, speeds, np.arange(0.0, end_knots(knots, speeds)[-1], step_s))
    width = max(1, round(RAMP_S / step_s))
    padded = np.concatenate((np.zeros(width), s, np.ones(width)))
    smooth = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    grid = np.arange(len(smooth)) * step_s
    progress = CubicSpline(grid, np.clip(smooth, 0.0, 1.0), bc_type="clamped")

    def evaluate(times_s: Array) -> tuple[Array, Array]:
        s = np.clip(progress(times_s), 0.0, 1.0)
        return q(s), q(s, 1) * progress(times_s, 1)[:, None]

    return evaluate, float(grid[-1])


def _slow_until_level(
    evaluate: Evaluate,
    duration_s: float,
    rows: Array,
    limits: JointLimits,
    tilt_max_rad: float,
    measure: Callable[[Trajectory], float],
) -> tuple[Trajectory, float]:
    """Sample, and slow the whole motion down until its measured tilt is allowed."""
    factor = 1.0
    while True:

        def slowed(times_s: Array, factor: float = factor) -> tuple[Array, Array]:
            q, qd = evaluate(times_s / factor)
            return q, qd / factor

        trajectory = sample_within_limits(slowed, factor * duration_s, rows[0], rows[-1], limits)
        tilt = measure(trajectory)
        if tilt <= tilt_max_rad:
            return trajectory, tilt
        factor *= SLOWDOWN
