"""When enough rollouts have been seen: Wald's sequential probability ratio test on their successes.

A. Wald, "Sequential Tests of Statistical Hypotheses" (1945), doi:10.1214/aoms/1177731118. Two chances are
distinguished, one below the threshold and one above it; in between the share decides when the requested rollouts are
used up. Clear cases take a few.
"""

import math

ERROR = 0.1  # chance of stopping on the wrong side at most, of each kind; whole rollouts make it less
BELOW, ABOVE = 0.2, 0.1  # how far from the threshold the two chances lie at most
TINY = 1e-6  # keeps logarithms finite


def is_decided(successes: int, trials: int, threshold: float, most: int) -> bool:
    """Whether more rollouts would hardly change on which side of the threshold (0..1) a chance is.

    There was at least one trial; after `most` of them it is decided in any case.
    """
    is_enough = successes >= threshold * trials
    left = most - trials
    if left <= 0 or successes >= threshold * most or successes + left < threshold * most:
        return True
    room = min(1.0, threshold / BELOW, (1.0 - threshold) / (2.0 * ABOVE))  # near 0 and 1 the two chances draw together
    low, high = threshold - room * BELOW, threshold + room * ABOVE
    ratio = successes * _log_ratio(high, low) + (trials - successes) * _log_ratio(1.0 - high, 1.0 - low)
    bound = math.log((1.0 - ERROR) / ERROR)
    return ratio >= bound if is_enough else ratio <= -bound


def _log_ratio(above: float, below: float) -> float:
    return math.log(max(above, TINY) / max(below, TINY))
