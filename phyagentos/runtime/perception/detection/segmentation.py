"""Pixels labelled by a detector instead of by colour.

Upstream: a detector. Downstream: `views`, which takes any segmenter. A detection is asked for in the words of the
inventory (`red cube`); its pixels get the main colour of that thing, by which fits and association go on as ever.
"""

import numpy as np
from numpy.typing import NDArray

from phyagentos.runtime.perception.colors import NO_COLOR
from phyagentos.runtime.perception.detection.detector import Detector
from phyagentos.runtime.perception.inventory import Inventory


class DetectorSegmenter:
    """A segmenter that asks a detector.

    Args:
        detector: Finds things by words.
        inventory: Of the scene, whose words are asked for.
    """

    def __init__(self, detector: Detector, inventory: Inventory) -> None:
        self._detector = detector
        self._colors = {
            f"{thing.template.color} {thing.template.kind}".strip(): thing.colors[0]
            for thing in inventory.things.values()
        }

    def label(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(h, w) index of the colour that each pixel of (h, w, 3) stands for.

        Raises:
            ExecutionError: With the detector's code.
        """
        labels = np.full(rgb.shape[:2], NO_COLOR, dtype=np.uint8)
        for found in reversed(self._detector.detect(rgb, tuple(self._colors))):  # the best last, on top
            left, top, width, height = found.box
            within = np.zeros(labels.shape, dtype=np.bool_)
            within[top : top + height, left : left + width] = True
            labels[within if found.mask is None else within & found.mask] = self._colors[found.label]
        return labels
