"""How far the colours that are seen of a thing are from those that it is known to have: their energy distance.

2 E|X - Y| - E|X - X'| - E|Y - Y'| (G. J. Szekely, M. L. Rizzo, "Energy statistics", J. Stat. Plan. Inference 143, 2013),
in CIE Lab, where lightness counts less: it is the light's as well.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.spatial.distance import cdist

from phyagentos.runtime.perception.solids import Array
from phyagentos.runtime.perception.views import Cloud

PIXELS = 250  # more do not make a share surer
SCALE = np.array((0.4, 1.0, 1.0)) / 100.0  # of lightness and the two axes of colour


def measure_look(look: Sequence[Array], seen: Cloud) -> float:
    """Mean over the pixels that cameras see of a thing: 0 for the colours of one of its sides, 1 for blue and yellow.

    Of each side a `look` has (k, 4) colours with their shares.
    """
    sides = [(_to_lab(side[:, :3]), side[:, 3] / side[:, 3].sum()) for side in look]
    total = 0.0
    for view in np.unique(seen.view_index):
        rgb = seen.rgb[seen.view_index == view]
        colors = _to_lab(rgb[:: max(1, len(rgb) // PIXELS)] / 255.0)
        away = min(2.0 * float((cdist(colors, known) @ w).mean()) - float(w @ cdist(known, known) @ w) for known, w in sides)
        total += len(rgb) * (away - float(cdist(colors, colors).mean()))
    return total / len(seen.rgb)


def _to_lab(rgb: Array) -> Array:
    lab: Array = cv2.cvtColor(rgb[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0] * SCALE
    return lab
