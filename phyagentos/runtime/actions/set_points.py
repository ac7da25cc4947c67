"""A skill's wish for one control period; with authority it becomes a `wire.Command`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SetPoints:
    """One control period, one row per physics step.

    Attributes:
        q_rad: (n_steps, n_joints) joint positions.
        qd_rad_s: (n_steps, n_joints) joint velocities.
        gripper_width_m: (n_steps,) openings.
    """

    q_rad: Array
    qd_rad_s: Array
    gripper_width_m: Array
