"""What sensors in the joints of an arm measure: positions, velocities and forces, late or with noise."""

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.capabilities.targets import Arm, TargetProfile
from phyagentos.protocol.world.seeds import compute_seed

Array = NDArray[np.float64]
FELT_NM = 1.0  # torque of contacts on a joint below which its sensor feels none
LEVER_M = 0.5  # of an arm's middle posture: forces below 2 N may be felt as none
SIGMAS = 3.0
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


class ForceEstimate:
    """Contact force as estimated from joint torques: a bias that stays for an episode, noise, and a dead zone.

    `error_n` is the greatest expected difference from the true force [N].
    """

    def __init__(self, profile: TargetProfile, seed: int, step_s: float) -> None:
        rng = np.random.default_rng(compute_seed(seed, "force estimate"))
        self._bias_n = float(rng.uniform(-1.0, 1.0)) * profile.force_bias_n
        self._noise_n = profile.force_noise_n * rng.standard_normal(MOMENTS)
        self._step_s = step_s
        self.error_n = max(profile.force_bias_n + SIGMAS * profile.force_noise_n, FELT_NM / LEVER_M)

    def is_felt(self, torques_nm: Array) -> bool:
        """Whether torques of contacts (n_joints,) exceed the dead zone of a joint."""
        return bool((np.abs(torques_nm) > FELT_NM).any())

    def measure(self, force_n: float, time_s: float) -> float:
        """Estimated force [N] for a true one that is felt, at a time [s]."""
        return max(0.0, force_n + self._bias_n + float(self._noise_n[round(time_s / self._step_s) % MOMENTS]))
