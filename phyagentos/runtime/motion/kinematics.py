"""Inverse kinematics from near: single postures and straight tool lines, with the compiled inverse of the chain.

A screened posture, or the one before on a line, is near enough for damped least squares. Where these stall, between
the limits of joints, mink's quadratic program in joint velocities tracks the tool frame, prefers a posture and respects
the limits. Collisions are checked afterwards: a collision limit makes the program fail more often.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phyagentos.runtime.motion.chain import LIMIT_MARGIN_RAD, Chain
from phyagentos.runtime.motion.poses import interpolate_poses
from phyagentos.runtime.motion.requests import Array, Differential
from phyagentos.runtime.motion.robot_model import RobotModel

LINE_STEP_M = 0.01
LINE_STEP_RAD = 0.1
PROGRAMS = 60  # at most, for a posture
POSE_JOINTS = 6  # fewer reach a pose only as exactly as the axes of a model are parallel
_DT_S = 0.1  # scales the velocity limits of the program only; convergence does not depend on it


class Tolerance(NamedTuple):
    """Largest error of a tool pose."""

    position_m: float
    rotation_rad: float


REACHED = Tolerance(1e-4, 1e-3)  # as the compiled screening: less than a tenth of what perception errs
POLISHED = Tolerance(1e-7, 1e-6)  # of goal postures; one or two programs beyond screening


@dataclass(frozen=True, slots=True)
class Solution:
    """A posture (n_joints,), or rows (k, n_joints), and how it was solved."""

    q_rad: Array
    solved: Differential


class Kinematics:
    """The inverse kinematics of one robot; `polished` is the tolerance of goal postures."""

    def __init__(self, robot: RobotModel, chain: Chain) -> None:
        self.chain = chain
        self.polished = POLISHED if len(chain.q_min_rad) >= POSE_JOINTS else REACHED
        self._robot = robot

    def solve(self, world_T_tcp: Array, start_rad: Array, tolerance: Tolerance = REACHED) -> Solution | None:
        """A posture near `start_rad` whose tool pose is within tolerance, or None."""
        found = self.chain.follow(np.array((world_T_tcp, world_T_tcp)), start_rad, tolerance)
        if found is None or found[2] >= tolerance.position_m or found[3] >= tolerance.rotation_rad:
            return self._solve_programs(world_T_tcp, start_rad, tolerance)
        rows, steps, off_m, off_rad = found
        return Solution(rows[1], Differential(steps, _round(off_m), _round(off_rad)))

    def _solve_programs(self, world_T_tcp: Array, start_rad: Array, tolerance: Tolerance) -> Solution | None:
        """The same by quadratic programs."""
        import mink  # with scipy, 0.4 s: only where it is used

        model = self._robot.model
        tool = mink.FrameTask(self._robot.profile.tcp, "site", position_cost=1.0, orientation_cost=0.5, lm_damping=1e-6)
        posture = mink.PostureTask(model, cost=1e-4)
        limits = [mink.ConfigurationLimit(model, gain=0.95, min_distance_from_limits=LIMIT_MARGIN_RAD)]
        tool.set_target(mink.SE3.from_matrix(world_T_tcp))
        posture.set_target(start_rad)
        configuration = mink.Configuration(model, q=start_rad)
        for iteration in range(PROGRAMS):
            error = tool.compute_error(configuration)
            off_m, off_rad = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
            if off_m < tolerance.position_m and off_rad < tolerance.rotation_rad:
                return Solution(np.array(configuration.q), Differential(iteration, _round(off_m), _round(off_rad)))
            try:
                rates = mink.solve_ik(configuration, [tool, posture], _DT_S, "daqp", damping=1e-6, limits=limits)
            except mink.NoSolutionFound:
                return None
            configuration.integrate_inplace(rates, _DT_S)
        return None

    def solve_line(self, start_rad: Array, end: Array) -> Solution | None:
        """Postures (k, n_joints) along the straight tool line from `start_rad`, row 0, to `end` (4, 4) `world_T_tcp`.

        None where the line leaves the workspace or jumps to another branch.
        """
        poses = interpolate_poses(self.chain.compute_tcp(start_rad), end, LINE_STEP_M, LINE_STEP_RAD)
        found = self.chain.follow(poses, start_rad, self.polished)
        if found is None:
            return None
        rows, steps, off_m, off_rad = found
        return Solution(rows, Differential(steps, _round(off_m), _round(off_rad)))


def _round(error: float) -> float:
    return float(f"{error:.2g}")


def combine(first: Differential, second: Differential) -> Differential:
    """The sum of both counts, the larger of both errors."""
    return Differential(
        first.iterations + second.iterations,
        max(first.position_error_m, second.position_error_m),
        max(first.rotation_error_rad, second.rotation_error_rad),
    )
