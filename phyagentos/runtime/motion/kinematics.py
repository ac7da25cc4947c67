"""Inverse kinematics of goal postures and of straight tool lines, by mink's quadratic programs.

The compiled inverse of the chain (`chain`) proposes: a screened posture, or a line followed roughly, which refuses what
is out of reach. mink then solves each proposal within the limits of the joints. Collisions are checked afterwards: a
collision limit makes the programs fail more often.
"""

from dataclasses import dataclass
from math import hypot
from typing import NamedTuple

import daqp
import mink
import numpy as np

from phyagentos.runtime.motion.calls import Solver, count_call
from phyagentos.runtime.motion.chain import Chain
from phyagentos.runtime.motion.poses import interpolate_poses
from phyagentos.runtime.motion.requests import Array, Differential
from phyagentos.runtime.motion.robot_model import RobotModel
from phyagentos.runtime.motion.timing import drop_duplicates, fit_spline

LINE_STEP_M = 0.01
LINE_STEP_RAD = 0.1
AT_END_RAD = 0.001  # of a joint's range: what stops there makes a corner
SAMPLES = 8  # of a smooth motion for each row
PROGRAMS = 20  # at most, for a posture; from a proposal one or two
POSE_JOINTS = 6  # fewer reach a pose only as exactly as the axes of a model are parallel
DAMPING = 1e-6  # among the postures of a redundant arm the nearest is taken
_STEP_S = 1.0  # cancels out: programs bound positions, not velocities


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
        self.chain, self._robot = chain, robot
        self.polished = POLISHED if len(chain.q_min_rad) >= POSE_JOINTS else REACHED
        self._tool = mink.FrameTask(
            robot.profile.tcp, "site", position_cost=1.0, orientation_cost=0.5, lm_damping=DAMPING
        )
        self._configuration = mink.Configuration(robot.model)
        self._no_rows = np.empty((0, len(chain.q_min_rad)))

    def solve(self, world_T_tcp: Array, start_rad: Array, tolerance: Tolerance = REACHED) -> Solution | None:
        """The first posture within tolerance, from a posture near it by one program or more, or None.

        A program: min |J dq - e|^2 + damping |dq|^2 with q_min <= q + dq <= q_max.
        """
        configuration, tool = self._configuration, self._tool
        tool.set_target(mink.SE3.from_matrix(world_T_tcp))
        configuration.update(start_rad)
        for iteration in range(1, PROGRAMS + 1):
            change = self._solve_program()
            if change is None:
                return None
            configuration.integrate_inplace(change, _STEP_S)
            error = tool.compute_error(configuration)
            off_m, off_rad = hypot(*error[:3].tolist()), hypot(*error[3:].tolist())
            if off_m < tolerance.position_m and off_rad < tolerance.rotation_rad:
                return Solution(np.array(configuration.q), Differential(iteration, _round(off_m), _round(off_rad)))
        return None

    def solve_line(self, start_rad: Array, end: Array) -> Solution | None:
        """Postures (k, n_joints) along the straight tool line from `start_rad`, row 0, to `end` (4, 4) `world_T_tcp`.

        None where the line leaves the workspace, jumps to another branch, or swings out at the end of a joint.
        """
        poses = interpolate_poses(self.chain.compute_tcp(start_rad), end, LINE_STEP_M, LINE_STEP_RAD)
        rows, solved = self.chain.follow(poses, start_rad), Differential(0, 0.0, 0.0)
        if rows is None:
            return None
        for k in range(1, len(rows)):
            found = self.solve(poses[k], rows[k])
            if found is None:
                return None
            rows[k], solved = found.q_rad, combine(solved, found.solved)
        return None if self._swings_out(rows) else Solution(rows, solved)

    def _swings_out(self, rows_rad: Array) -> bool:
        """Whether the smooth motion through a line that stops at the end of a joint's range goes beyond it."""
        low, high = self.chain.q_min_rad + AT_END_RAD, self.chain.q_max_rad - AT_END_RAD
        kept = drop_duplicates(rows_rad)
        if len(kept) < 2 or not np.any((kept < low) | (kept > high)):
            return False
        return self._robot.exceeds_limits(fit_spline(kept)(np.linspace(0.0, 1.0, SAMPLES * len(kept))))

    def _solve_program(self) -> Array | None:
        """The change of posture (n_joints,) at the least of a program; by daqp itself, `mink.solve_ik` adds a third.

        daqp takes the limits of joints as bounds, which costs half of their rows in a `mink.ConfigurationLimit`.
        """
        count_call(Solver.MINK)
        configuration, chain = self._configuration, self.chain
        program = mink.build_ik(configuration, [self._tool], _STEP_S, DAMPING, limits=[])
        q_rad = configuration.q
        change, _, status, _ = daqp.solve(
            program.P,
            program.q,
            self._no_rows,
            chain.q_max_rad - q_rad,
            chain.q_min_rad - q_rad,
            np.zeros(len(q_rad), np.int32),
        )
        return change if status > 0 else None


def _round(error: float) -> float:
    return float(f"{error:.2g}")


def combine(first: Differential, second: Differential) -> Differential:
    """The sum of both counts, the larger of both errors."""
    return Differential(
        first.iterations + second.iterations,
        max(first.position_error_m, second.position_error_m),
        max(first.rotation_error_rad, second.rotation_error_rad),
    )
