"""Timing of a carry: as fast as grip and contents allow, shaped with casadi.

A held object feels the apparent gravity f = p'' + g e_z. It slips when the tangential force and the torque about the
closing axis leave the grip's limit surface, an ellipsoid; an open vessel spills when f leans too far from its axis.
Only the progress s(t) along the path is optimised. In b = s'^2, piecewise linear, the largest b is the fastest motion:
a convex program with linear costs, one stage a knot, which fatrop solves. Its graph is built once for each number of
joints, paths are parameters. Alternatives rejected: ipopt on the duration itself took 0.3 to 1.3 s and failed on a
general path; quadratic programs with facets in place of cones took five times as long.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import casadi as ca
import msgspec
import numpy as np
from scipy.interpolate import CubicSpline

from phyagentos.runtime.motion.calls import Solver, count_call
from phyagentos.runtime.motion.chain import Chain
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.requests import Array, Load, Motion, NoPlan, ShapeTransport, Stages, Trajectory
from phyagentos.runtime.motion.timing import (
    ACCELERATION_SCALE,
    VELOCITY_SCALE,
    JointLimits,
    Timed,
    compute_progress,
    drop_duplicates,
    end_knots,
    fit_spline,
    sample_within_limits,
    time_path,
)

Evaluate = Callable[[Array], tuple[Array, Array]]

GRAVITY_M_S2 = 9.81
INTERVALS = 40
GRID = 121  # samples of the path that its derivatives are interpolated over
SPACING_RAD = 0.02  # between waypoints; closer ones come from a sampled trajectory and only add noise
MARGIN = 0.95  # constraints hold at the knots; between them the values may be a little larger
GRIP_SHARE = 0.8  # of what the grip bears at the bad ends of all uncertainties
REST_SHARE = 1.1  # of what gravity alone takes, where that is more
PAD_RADIUS_M = 0.008  # lever of a pad's friction against turning: two thirds of its contact's radius
RAMP_S, LEVEL_RAMP_S = 0.04, 0.1  # over which acceleration builds up; for an open vessel
LIGHT_SHARE = 0.2  # of the grip; where an arm overshoots each jump of acceleration by all of it, that is two fifths
LONGER = 1.15  # times toppra's motion, where both keep within the bounds; ramps take about a tenth
SLOWDOWN = 1.03
SLOWEST = 40  # slowdowns, after which a carry is as slow as its path is long
STRIDE = 2  # samples between those that are measured


@dataclass(frozen=True, slots=True)
class CarryConstraints:
    """What a carry must respect; None where nothing is asked.

    `tilt_max_rad` is the greatest angle between an open vessel's axis and the apparent gravity [rad].
    """

    load: Load | None = None
    tilt_max_rad: float | None = None


def shape_transport(request: ShapeTransport, chain: Chain, limits: JointLimits, job: Job) -> Motion | NoPlan:
    """The timed motion; its stages hold what the payload feels, shaped and unshaped."""
    rows = np.asarray(request.waypoints_rad, dtype=float)
    care = CarryConstraints(request.load, request.tilt_max_rad)
    with job.stage("shape"):
        poses = chain.compute_tcp_path(drop_duplicates(rows, SPACING_RAD))
        lean = float(np.arccos(np.clip((poses[:, :3, :3] @ poses[0, :3, :3].T)[:, 2, 2].min(), -1.0, 1.0)))
        if request.method != "toppra" and lean >= MARGIN * request.tilt_max_rad:
            return job.fail("NO_PLAN", f"The path itself tilts the vessel by {lean:.3f} rad of {request.tilt_max_rad}.")
        timed = time_carry(rows, limits, chain, care, is_shaped=request.method != "toppra")
        tilt_rad = timed.scaling.worst_tilt_rad
        if timed.scaling.solver == "casadi" and tilt_rad is not None and tilt_rad > request.tilt_max_rad:
            return job.fail(
                "NO_PLAN",
                message=f"The carry tilts the vessel by {tilt_rad:.3f} rad of {request.tilt_max_rad} at its slowest.",
            )
    return Motion(trajectory=timed.trajectory, goal=0, timing=job.timing, stages=Stages(scaling=timed.scaling))


def time_carry(
    rows_rad: Array,
    limits: JointLimits,
    chain: Chain,
    care: CarryConstraints,
    *,
    is_shaped: bool = True,
    keeps_toppra: bool = False,
) -> Timed:
    """The motion through rows (k, n_joints), from rest to rest, that respects what it carries.

    Toppra's motion is returned if it does so already and either it `keeps_toppra`, uses `LIGHT_SHARE` of the grip at
    most, or the shaped one takes `LONGER`: joints that turn a corner between two knots faster than they may stretch all
    of it.
    """
    rows = drop_duplicates(rows_rad, SPACING_RAD)
    timed = time_path(rows_rad, limits)
    plain = timed.trajectory
    share, tilt_rad = measure_felt(plain, rows[0], chain, care)
    felt = _note(share, tilt_rad, care)
    unshaped = {f"unshaped_{name}": value for name, value in felt.items()}
    scaling = msgspec.structs.replace(timed.scaling, unshaped_duration_s=timed.scaling.duration_s, **felt, **unshaped)
    unshaped_motion = Timed(plain, scaling)
    enough = GRIP_SHARE if keeps_toppra else LIGHT_SHARE
    if not is_shaped or len(rows) < 2 or (care.tilt_max_rad is None and share <= enough):
        return unshaped_motion
    path = _Path.describe(rows, chain, care)
    evaluate, duration_s, status, iterations = _optimise(
        path, limits, plain.duration_s, ramp_s=RAMP_S if care.tilt_max_rad is None else LEVEL_RAMP_S
    )
    tilt_max_rad = np.inf if care.tilt_max_rad is None else care.tilt_max_rad
    enough_s = LONGER * plain.duration_s if tilt_rad <= tilt_max_rad and share <= path.budget else np.inf
    for slowdowns in range(SLOWEST):
        factor = SLOWDOWN**slowdowns

        def slowed(times_s: Array, factor: float = factor) -> tuple[Array, Array]:
            q, qd = evaluate(times_s / factor)
            return q, qd / factor

        trajectory = sample_within_limits(slowed, factor * duration_s, rows[0], rows[-1], limits)
        if trajectory.duration_s > enough_s:
            return unshaped_motion
        share, tilt_rad = measure_felt(trajectory, rows[0], chain, care)
        if tilt_rad <= tilt_max_rad and share <= path.budget:
            break
    felt, duration_s = _note(share, tilt_rad, care), round(trajectory.duration_s, 4)
    solved = {"solver": "casadi", "status": status, "solver_iterations": iterations}
    return Timed(trajectory, msgspec.structs.replace(scaling, duration_s=duration_s, **solved, **felt))


def _note(share: float, tilt_rad: float, care: CarryConstraints) -> dict[str, float]:
    share_of_load = {} if care.load is None else {"grip_share": round(share, 4)}
    return share_of_load if care.tilt_max_rad is None else share_of_load | {"worst_tilt_rad": round(tilt_rad, 5)}


def measure_felt(trajectory: Trajectory, start_rad: Array, chain: Chain, care: CarryConstraints) -> tuple[float, float]:
    """Greatest share of the grip and greatest apparent tilt [rad] over a trajectory from rest at `start_rad`."""
    step_s = STRIDE * trajectory.step_s
    rows = np.vstack((start_rad, start_rad, trajectory.q_rad[STRIDE - 1 :: STRIDE], trajectory.q_rad[-1:]))
    poses = chain.compute_tcp_path(rows)
    rotations = poses[1:-1, :3, :3]
    center = np.zeros(3) if care.load is None else np.array(care.load.center_m)
    f = np.diff(poses[:, :3, 3] + poses[:, :3, :3] @ center, n=2, axis=0) / step_s**2
    f = np.einsum("kji,kj->ki", rotations, f + np.array((0.0, 0.0, GRAVITY_M_S2)))  # in the tool frame
    turns = np.einsum("kij,kil->kjl", poses[:-1, :3, :3], poses[1:, :3, :3])
    spin = 0.5 * np.diff(turns[:, 0, 2] - turns[:, 2, 0]) / step_s**2  # about the closing axis
    share = 0.0 if care.load is None else float(np.sqrt((_grip(f.T, spin, care.load) ** 2).sum(axis=0)).max())
    n = rotations[0].T @ np.array((0.0, 0.0, 1.0))  # the vessel's axis in the tool frame
    along = f @ n
    return share, float(np.arctan2(np.linalg.norm(f - along[:, None] * n, axis=1), along).max())


def _grip(f: Array, spin: Array, load: Load) -> Array:
    """(3, k) forces along x and z and torque about y, in shares of what the grip bears; f (3, k) in the tool frame."""
    bears = 2.0 * load.friction * load.press_n / load.mass_kg
    torque = load.center_m[2] * f[0] - load.center_m[0] * f[2] + load.gyration_m**2 * spin
    return np.array((f[0], f[2], torque / PAD_RADIUS_M)) / bears


@dataclass(frozen=True, slots=True)
class _Path:
    """A path at both ends of its intervals, with what a payload feels as coefficients of b, a = s'' and 1.

    `grip` (3, 3, 2 n) are shares of the grip, of which `budget` may be used; `vessel` (3, 3, 2 n) lateral, lateral and
    axial apparent gravity, the lateral ones over the tangent allowed.
    """

    q: CubicSpline
    grip: Array
    vessel: Array
    budget: float

    @classmethod
    def describe(cls, rows: Array, chain: Chain, care: CarryConstraints) -> "_Path":
        s, q, load = np.linspace(0.0, 1.0, GRID), fit_spline(rows), care.load
        poses = chain.compute_tcp_path(q(s))
        axes = CubicSpline(s, poses[:, :3, :3])
        center = np.zeros(3) if load is None else np.array(load.center_m)
        p = CubicSpline(s, poses[:, :3, 3] + poses[:, :3, :3] @ center)
        gravity, R = np.tile((0.0, 0.0, GRAVITY_M_S2), (len(ENDS), 1)), axes(ENDS)
        f = [np.einsum("kji,kj->ik", R, each) for each in (p(ENDS, 2), p(ENDS, 1), gravity)]
        grip, vessel, budget = np.zeros((3, 3, len(ENDS))), np.zeros((3, 3, len(ENDS))), 1.0
        vessel[2, 2] = 1.0
        if load is not None:
            about_y = (np.einsum("ki,ki->k", R[:, :, 0], axes(ENDS, order)[:, :, 2]) for order in (2, 1))
            turns = (*about_y, np.zeros(len(ENDS)))  # the coefficients of the angular acceleration
            grip = np.array([_grip(each, turn, load) for each, turn in zip(f, turns, strict=True)])
            budget = max(GRIP_SHARE, REST_SHARE * float(np.linalg.norm(grip[2], axis=0).max()))
        if care.tilt_max_rad is not None:
            vessel = np.array([poses[0, :3, :3] @ each for each in f]) / GRAVITY_M_S2  # upright at the start
            vessel[:, :2] /= np.tan(MARGIN * care.tilt_max_rad)
        return cls(q, grip / (MARGIN * budget), vessel, budget)


KNOTS: Array = (1.0 - np.cos(np.linspace(0.0, np.pi, INTERVALS + 1))) / 2.0  # denser where it starts and stops
ENDS: Array = np.column_stack((KNOTS[:-1], KNOTS[1:])).ravel()  # (2 n,) of the intervals
_COUNT = 18  # coefficients of a point besides those of the joints


@cache
def _build(n_joints: int) -> tuple[ca.Function, Array, Array]:
    """The solver for paths of so many joints, and its bounds; (b, a) of each knot in turn, then the last b."""
    h = np.diff(KNOTS)
    b, a = ca.SX.sym("b", INTERVALS + 1), ca.SX.sym("a", INTERVALS)
    given = ca.SX.sym("given", 2 * n_joints + _COUNT, 2 * INTERVALS)
    constraints, low, high, equality = [], [], [], []

    def require(expression: ca.SX, least: float, most: float) -> None:
        n = expression.numel()
        constraints.append(expression)
        low.extend([least] * n)
        high.extend([most] * n)
        equality.extend([least == most] * n)

    for k in range(INTERVALS):
        following = b[k] + 2.0 * float(h[k]) * a[k]
        require(b[k + 1] - following, 0.0, 0.0)
        for point, value in ((2 * k, b[k]), (2 * k + 1, following)):
            column = given[:, point]
            require(column[n_joints : 2 * n_joints] * value + column[:n_joints] * a[k], -1.0, 1.0)
            felt = [
                column[2 * n_joints + 3 * i] * value
                + column[2 * n_joints + 3 * i + 1] * a[k]
                + column[2 * n_joints + 3 * i + 2]
                for i in range(6)
            ]
            require(felt[0] ** 2 + felt[1] ** 2 + felt[2] ** 2, -np.inf, 1.0)
            require(felt[3] ** 2 + felt[4] ** 2 - felt[5] ** 2, -np.inf, 0.0)
            require(felt[5], 0.1, np.inf)
    states = [value for k in range(INTERVALS) for value in (b[k], a[k])]
    solver = ca.nlpsol(
        "carry",
        "fatrop",
        {
            "x": ca.vertcat(*states, b[INTERVALS]),
            "f": -ca.dot(b[1:], ca.DM(h)),
            "g": ca.vertcat(*constraints),
            "p": ca.vec(given),
        },
        {
            "structure_detection": "auto",
            "equality": equality,
            "fatrop.print_level": 0,
            "fatrop.tol": 1e-4,
            "print_time": False,
            "error_on_fail": False,
        },
    )
    return solver, np.array(low), np.array(high)


def _optimise(path: _Path, limits: JointLimits, unit_s: float, ramp_s: float) -> tuple[Evaluate, float, str, int]:
    """The motion, its duration [s], the solver's status and iterations; b and a are in units of `unit_s`."""
    solver, low, high = _build(path.q.c.shape[2])
    hardest = ACCELERATION_SCALE * unit_s**2 * limits.acceleration_rad_s2
    scale = np.array((unit_s**-2, unit_s**-2, 1.0))[:, None, None]
    felt = [(scale * each).transpose(1, 0, 2).reshape(9, -1) for each in (path.grip, path.vessel)]
    given = np.vstack(((path.q(ENDS, 1) / hardest).T, (path.q(ENDS, 2) / hardest).T, *felt))
    fastest = VELOCITY_SCALE * unit_s * limits.velocity_rad_s
    size = 2 * INTERVALS + 1
    least, most, start = np.full(size, -np.inf), np.full(size, np.inf), np.zeros(size)
    least[::2], start[::2] = 0.0, 0.4 * KNOTS * (1.0 - KNOTS)
    most[::2] = ((fastest / np.maximum(np.abs(path.q(KNOTS, 1)), 1e-9)) ** 2).min(axis=1)
    most[[0, -1]] = 0.0
    count_call(Solver.CASADI)
    found = solver(x0=start, p=given.T.ravel(), lbx=least, ubx=most, lbg=low, ubg=high)
    b = np.clip(found["x"].full().ravel()[::2], 1e-6, None)  # one that did not converge is slowed down
    b[[0, -1]] = 0.0
    stats = solver.stats()
    evaluate, duration_s = _follow(path.q, b, unit_s, limits.step_s, ramp_s)
    return evaluate, duration_s, "solved" if stats["success"] else "not converged", int(stats["iter_count"])


def _follow(q: CubicSpline, b: Array, unit_s: float, step_s: float, ramp_s: float) -> tuple[Evaluate, float]:
    """The motion with b = s'^2 at the knots, its progress averaged over a window so that acceleration never steps."""
    speeds = np.sqrt(b) / unit_s
    s, _ = compute_progress(KNOTS, speeds, np.arange(0.0, end_knots(KNOTS, speeds)[-1], step_s))
    width = max(1, round(ramp_s / step_s))
    padded = np.concatenate((np.zeros(width), s, np.ones(width)))
    smooth = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    grid = np.arange(len(smooth)) * step_s
    progress = CubicSpline(grid, np.clip(smooth, 0.0, 1.0), bc_type="clamped")

    def evaluate(times_s: Array) -> tuple[Array, Array]:
        s = np.clip(progress(times_s), 0.0, 1.0)
        return q(s), q(s, 1) * progress(times_s, 1)[:, None]

    return evaluate, float(grid[-1])
