"""Inverse kinematics with mink: single postures and straight tool lines.

Upstream: `Chain`, whose compiled solver screens candidates. Downstream: grasps, placements, lines. Differential inverse
kinematics is a quadratic program in joint velocities: track the tool frame, prefer a posture, respect joint limits.
Collisions are no part of it (a collision limit makes it fail more often): what it finds is checked afterwards.
"""

import mink
import numpy as np
from numpy.typing import NDArray

from phyagentos.runtime.motion.chain import LIMIT_MARGIN_RAD, Chain
from phyagentos.runtime.motion.poses import interpolate_poses
from phyagentos.runtime.motion.robot_model import RobotModel

Array = NDArray[np.float64]

POSITION_TOLERANCE_M = 1e-4
ROTATION_TOLERANCE_RAD = 1e-3
LINE_STEP_M = 0.01
LINE_STEP_RAD = 0.1
JUMP_MAX_RAD = 0.35  # a larger step between neighbours on a line is another branch of the inverse
_DT_S = 0.1  # scales the velocity limits of the program only; convergence does not depend on it


class Kinematics:
    """The inverse kinematics of one robot."""

    def __init__(self, robot: RobotModel, chain: Chain) -> None:
        self.chain = chain
        self._configuration = mink.Configuration(robot.model)
        self._tool = mink.FrameTask(robot.profile.tcp, "site", position_cost=1.0, orientation_cost=0.5, lm_damping=1e-6)
        self._posture = mink.PostureTask(robot.model, cost=1e-4)
        self._limits = [mink.ConfigurationLimit(robot.model, gain=0.95, min_distance_from_limits=LIMIT_MARGIN_RAD)]

    def solve(self, world_T_tcp: Array, start_rad: Array, max_iterations: int = 60) -> Array | None:
        """A posture (n_joints,) near `start_rad` whose tool pose is within tolerance, or None."""
        self._tool.set_target(mink.SE3.from_matrix(world_T_tcp))
        self._posture.set_target(start_rad)
        configuration = self._configuration
        configuration.update(start_rad)
        for _ in range(max_iterations):
            error = self._tool.compute_error(configuration)
            if np.linalg.norm(error[:3]) < POSITION_TOLERANCE_M and np.linalg.norm(error[3:]) < ROTATION_TOLERANCE_RAD:
                return np.array(configuration.q)
            try:
                velocity = mink.solve_ik(
                    configuration, [self._tool, self._posture], _DT_S, "daqp", damping=1e-6, limits=self._limits
                )
            except mink.NoSolutionFound:
                return None
            configuration.integrate_inplace(velocity, _DT_S)
        return None

    def solve_line(self, start_rad: Array, end: Array) -> Array | None:
        """Postures along the straight tool line from where `start_rad` points the tool to `end`.

        Args:
            start_rad: (n_joints,) first posture.
            end: (4, 4) `world_T_tcp` at the end.

        Returns:
            (k, n_joints), row 0 is `start_rad`; None where the line leaves the workspace or jumps between branches.
        """
        line = [np.array(start_rad)]
        start = self.chain.compute_tcp(line[0])
        for pose in interpolate_poses(start, end, LINE_STEP_M, LINE_STEP_RAD)[1:]:
            q = self.solve(pose, line[-1], max_iterations=25)
            if q is None or np.abs(q - line[-1]).max() > JUMP_MAX_RAD:
                return None
            line.append(q)
        return np.array(line)
