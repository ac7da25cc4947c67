"""What the encoders of an arm measure: joint positions and velocities, late and with noise."""

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.capabilities.targets import Arm
from phyagentos.protocol.world.seeds import compute_seed

Array = NDArray[np.float64]
MOMENTS = 4096  # of noise, which are drawn once and then repeat: eight seconds of physics steps of 2 ms


class JointSensors:
    """Noise follows from the scene's seed and the time: a repeated or restored run measures the same."""

    def __init__(self, arm: Arm, seed: int, step_s: float) -> None:
        rng = np.random.default_rng(compute_seed(seed, "joint sensors"))
        scale = np.array((arm.position_noise_rad, arm.velocity_noise_rad_s))[:, None]
        self._noise = scale * rng.standard_normal((MOMENTS, 2, len(arm.joints)))
        self._delay_s, self._step_s = arm.state_delay_s, step_s

    def measure(self, q_rad: Array, qd_rad_s: Array, time_s: float) -> tuple[Array, Array]:
        """Measured positions (n_joints,) [rad] and velocities (n_joints,) [rad/s] for the true ones at a time [s]."""
        q_noise, qd_noise = self._noise[round(time_s / self._step_s) % MOMENTS]
        return q_rad - self._delay_s * qd_rad_s + q_noise, qd_rad_s + qd_noise
