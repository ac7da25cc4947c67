"""How far the colours that are seen of a thing are from those that it is known to have: their energy distance.

2 E|X - Y| - E|X - X'| - E|Y - Y'| (G. J. Szekely, M. L. Rizzo, "Energy statistics", 2013).
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.spatial.distance import cdist

from phyagentos.runtime.perception.solids import Array
from phyagentos.runtime.perception.views import Cloud

PIXELS = 250  # more do not make a share surer
SCALE = np.array((0.4, 1.0, 1.0)) / 100.0  # of CIE Lab: its lightness is the light's as well


def measure_look(look: Sequence[Array], seen: Cloud) -> float:
    """Mean over the pixels of a thing: 0 for the colours (k, 4), with shares, of one side; 1 for blue and yellow."""
    sides, total = [(_to_lab(side[:, :3]), side[:, 3] / side[:, 3].sum()) for side in look], 0.0
    for view in np.unique(seen.view_index):
        rgb = seen.rgb[seen.view_index == view]
        own = _to_lab(rgb[:: max(1, len(rgb) // PIXELS)] / 255.0)
        away = min(2.0 * (cdist(own, known) @ w).mean() - w @ cdist(known, known) @ w for known, w in sides)
        total += len(rgb) * float(away - cdist(own, own).mean())
    return total / len(seen.rgb)


def _to_lab(rgb: Array) -> Array:
    return np.asarray(cv2.cvtColor(rgb[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0] * SCALE)
