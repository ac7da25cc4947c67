"""States how far a fitted pose may be off: what the points leave open, and what the method adds to every look.

The open part is the covariance of the fit, variance times the inverse of its normal equations (W. Triggs et al.,
"Bundle adjustment - a modern synthesis", 2000, section 6); it falls with the number of looks. The other part is common
to all looks at an unchanged object: calibration, wavering edges, walls seen from one side. It never falls.
"""

from dataclasses import dataclass

import numpy as np

from phyagentos.protocol.world.environment import LEAST_STD_M
from phyagentos.runtime.perception.solid_distance import linearise
from phyagentos.runtime.perception.solids import Array

CORRELATED = 2.0  # neighbouring pixels share their errors: so many of them count as one
SHIFTED = 0.5  # of that variance, what turns an object; what pixels share shifts it
SIGMA = 1.4826  # of a normal distribution, by its median distance
RESIDUAL_M = 0.0005  # no residual is less: the model of an object is as exact as this
BIAS_M = LEAST_STD_M  # of a position in every look
BIAS_PER_M = 180.0  # by which that grows with the variance
PATH_CALIBRATION, PATH_BIAS_PER_M = 0.6, 120.0  # of a position on a path: per noise in one camera, and the variance
BIAS_TURN = 0.7  # of the same shift between two ends of an object
OPEN_LEAST = 0.1  # of the common variance: a mean of more looks than it takes to come to this would not follow
OUTLINE_M, OUTLINE_TURN = 0.004, 2.0  # where a visible face ends fixes its object this well, and a turn by its width
MAP_STDS = np.array([0.001, 0.002])  # of what is known from the scene file and not measured: place [m] and turn [rad]
UPRIGHT_STDS = 3.0  # a lean of less than this many deviations is none that the pixels show
FREE = np.ones(6)


@dataclass(frozen=True, slots=True)
class PoseUncertainty:
    """Standard deviations (2,) of a pose in one look: of its position [m] and of its turn [rad].

    `common` is the part that all looks have in common; of that of its position, `hidden_m` is due to what hides it now.
    """

    total: Array
    common: Array
    hidden_m: float = 0.0

    def of_measured(self, size_std_m: float) -> "PoseUncertainty":
        """The same for an object whose own sides are known to this deviation [m]: its middle is off by half of it."""
        parts = np.array([size_std_m / 2.0, 0.0])
        return PoseUncertainty(np.hypot(self.total, parts), np.hypot(self.common, parts), self.hidden_m)

    def of_hidden(self, other: Array) -> "PoseUncertainty":
        """The same where another pose, so far away (2,), fits as well; no look at what hides the object tells which."""
        parts = other / 2.0
        return PoseUncertainty(np.hypot(self.total, parts), np.hypot(self.common, parts), float(parts[0]))

    def compute_gain(self, before: Array) -> Array:
        """(2,) weights of this look in the mean with those before, whose deviations are `before` (2,)."""
        shared = np.minimum(self.common, before) ** 2
        old, new = np.maximum(before**2 - shared, OPEN_LEAST * shared), self.total**2 - shared
        gain: Array = old / np.maximum(old + new, 1e-12)
        return gain

    def fuse(self, before: Array) -> Array:
        """(2,) deviations of that mean; of its position never less than the common part of this look that is seen."""
        gain, shared = self.compute_gain(before), np.minimum(self.common, before) ** 2
        square = ((1 - gain) * before) ** 2 + (gain * self.total) ** 2 + 2 * gain * (1 - gain) * shared
        seen_m = np.sqrt(self.common[0] ** 2 - self.hidden_m**2) if self.hidden_m else self.common[0]
        kept = np.minimum(self.common, before)
        least = np.array([max(seen_m, kept[0]), kept[1]])  # few turn where they stay
        fused: Array = np.maximum(np.sqrt(square), least)
        return fused


def compute_uncertainty(
    distance_m: Array,
    gradient: Array,
    arm_m: Array,
    rotation: Array,
    axes: Array,
    width_m: float,
    free: Array,
    huber_m: float,
    path: Array | None = None,
    cameras: int = 1,
) -> PoseUncertainty:
    """The uncertainty of a fit.

    Args:
        distance_m: (n,) of its points.
        gradient: (n, 3) of these, in the object's frame.
        arm_m: (n, 3) from the object's origin to its points, in the world.
        rotation: (3, 3) `world_T_thing`.
        axes: (3, k) turns that its surface shows, in its frame.
        width_m: Of the object.
        free: (6,) is 1 for each free motion of the fit; what is not free is known as well as the map is.
        huber_m: Distances beyond this are weighted down.
        path: (6,) the only motion of a part of a mechanism, for one metre along it, which the result is about then.
        cameras: That see it: each has a calibration of its own.
    """
    arm_m, turned = np.ascontiguousarray(arm_m), np.ascontiguousarray(rotation)
    jacobian, weighted = linearise(distance_m, gradient, arm_m, turned, np.arange(6), huber_m)
    weight = huber_m / np.maximum(np.abs(distance_m), huber_m)
    variance = float(np.sum(weight * np.minimum(np.abs(distance_m), 3 * huber_m) ** 2) / max(np.sum(weight), 1.0))
    broad_m = SIGMA * float(np.median(np.abs(distance_m)))  # of noise broader than the weights let through
    variance = max(variance, broad_m**2, RESIDUAL_M**2)
    motions = np.zeros((6, 3 + axes.shape[1]))
    motions[:3, :3], motions[3:, 3:] = np.eye(3), rotation @ axes
    motions *= free[:, None]
    outline_m = max(OUTLINE_M, float(np.sqrt(variance)))  # a visible edge wavers as depth does
    known = np.array([outline_m] * 3 + [OUTLINE_TURN * outline_m / max(width_m, 1e-3)] * axes.shape[1])
    bias_turn = BIAS_TURN / max(width_m, 1e-3) if axes.shape[1] and np.any(free[3:]) else 0.0
    bias_m, is_map = BIAS_M + BIAS_PER_M * variance, free.reshape(2, 3).min(axis=1) == 0.0
    if path is not None:
        motions, known = path[:, None], known[:1]
        bias_turn, is_map = float(np.linalg.norm(path[3:])), np.array([False, True])
        bias_m = float(np.hypot(PATH_CALIBRATION * np.sqrt(variance / cameras), PATH_BIAS_PER_M * variance))
    matrix = motions.T @ (weighted @ jacobian.T) @ motions / (CORRELATED * variance) + np.diag(known**-2.0)
    covariance = motions @ np.linalg.inv(matrix) @ motions.T
    parts = covariance[:3, :3], covariance[3:, 3:]
    left = np.array([max(np.linalg.eigvalsh(part)[-1], 0.0) for part in parts])  # (2,) variances that the points leave
    left *= (1.0, SHIFTED if path is None else 1.0)
    common = np.hypot(np.array([bias_m, bias_turn * bias_m]), MAP_STDS * is_map)
    return PoseUncertainty(np.sqrt(left + common**2), common)
