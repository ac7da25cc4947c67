"""A skill's wish for one control period; with authority it becomes a `wire.Command`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SetPoints:
    """One control period, one row per physics step: (n_steps, n_joints) of the arm, (n_steps,) of the opening."""

    q_rad: Array
    qd_rad_s: Array
    gripper_width_m: Array
