"""The port of detectors: a picture and words in, boxes and masks with scores out.

Upstream: `registry`. Downstream: `segmentation`, which turns what they find into labelled pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Colours = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """One thing in one picture.

    Attributes:
        label: Of those that were asked for.
        score: 0..1.
        box: (left, top, width, height) [pixels].
        mask: (height of the picture, width of the picture); None where only the box is known.
    """

    label: str
    score: float
    box: tuple[int, int, int, int]
    mask: NDArray[np.bool_] | None = None


class Detector(Protocol):
    """Finds things in pictures by words."""

    def detect(self, rgb: Colours, labels: Sequence[str]) -> tuple[Detection, ...]:
        """Every thing that a label fits, the best first.

        Args:
            rgb: (h, w, 3) uint8.
            labels: Words, such as `red cube`.

        Raises:
            ExecutionError: With the code of what kept it from answering.
        """
        ...

    def close(self) -> None:
        """Let go of what it holds."""
        ...
