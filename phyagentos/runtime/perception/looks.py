"""How far the colours that are seen of a thing are from those that it is known to have: their energy distance.

2 E|X - Y| - E|X - X'| - E|Y - Y'| (G. J. Szekely, M. L. Rizzo, "Energy statistics", J. Stat. Plan. Inference 143, 2013),
in CIE Lab, where lightness counts less: it is the light's as well.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from phyagentos.runtime.perception.solids import Array

PIXELS = 250  # more do not make a share surer
SCALE = np.array((0.4, 1.0, 1.0)) / 100.0  # of lightness and the two axes of colour


def measure_look(look: Array, rgb: NDArray[np.uint8]) -> float:
    """Distance between colours with their shares (k, 4) and pixels (n, 3): 0 where equal, 1 for blue and yellow."""
    known, shares = _to_lab(look[:, :3]), look[:, 3] / look[:, 3].sum()
    seen = _to_lab(rgb[:: max(1, len(rgb) // PIXELS)] / 255.0)
    across = float((cdist(seen, known) @ shares).mean())
    return 2.0 * across - float(cdist(seen, seen).mean()) - float(shares @ cdist(known, known) @ shares)


def _to_lab(rgb: Array) -> Array:
    lab: Array = cv2.cvtColor(rgb[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0] * SCALE
    return lab
