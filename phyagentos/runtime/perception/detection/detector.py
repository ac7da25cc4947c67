"""The port of detectors: a picture and words in, boxes and masks with scores out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Colours = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """One object in one picture, with one of the requested labels and a score in 0..1.

    `box` is (left, top, width, height) [pixels]; `mask` (h, w) is None where only the box is known.
    """

    label: str
    score: float
    box: tuple[int, int, int, int]
    mask: NDArray[np.bool_] | None = None


class Detector(Protocol):
    """Finds objects in pictures by words."""

    def detect(self, rgb: Colours, labels: Sequence[str]) -> tuple[Detection, ...]:
        """All matches of the labels (`red cube`) in a picture (h, w, 3), the best first.

        Raises:
            ExecutionError: With the code of the failure.
        """

    def close(self) -> None:
        """Release resources."""
