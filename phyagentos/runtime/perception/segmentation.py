"""Labels each pixel with a colour of the inventory: by the pixel's own colour, or by a detector."""

from collections.abc import Iterable
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from phyagentos.runtime.perception.detection.detector import Detector
from phyagentos.runtime.perception.inventory import Inventory
from phyagentos.runtime.perception.solids import Array

BITS = 5  # per channel of the table: 32768 entries
LIGHTS = np.linspace(0.3, 1.6, 14)  # from shade to more light than a picture can show
NO_COLOR = 255
FARTHEST = 0.24  # of a normalised colour from every curve: something that the scene file does not know
NEAR = 0.11  # of colours that are taken for each other in shade, in light and at edges
DIM = 0.02  # of full brightness: too dark to label


class Segmenter(Protocol):
    """Labels pixels."""

    def label(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(h, w) palette index of each pixel of (h, w, 3); raises ExecutionError."""


class Palette:
    """Labels pixels by their colour, 0..1, out of (k, 3) colours of surfaces, under any light.

    A lit surface of one colour is on a ray from black through its colour, bent where a channel saturates; a pixel
    belongs to the nearest such curve. A lookup table holds the answer for every colour.
    """

    def __init__(self, colors: Array) -> None:
        levels = (np.arange(2**BITS) + 0.5) / 2**BITS
        grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij")).reshape(3, -1).T
        curves = np.clip(colors[:, None, :] * LIGHTS[None, :, None], 0.0, 1.0)  # (k, lights, 3)
        best = np.full(len(grid), np.inf)
        label = np.full(len(grid), NO_COLOR, dtype=np.uint8)
        for index, curve in enumerate(curves):
            own = np.min([_measure(grid, point) for point in curve], axis=0)
            closer = own < best
            best[closer], label[closer] = own[closer], index
        label[(best > FARTHEST) | (grid.max(axis=1) < DIM)] = NO_COLOR
        self._labels = label

    def label(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(...,) index of the colour of each pixel (..., 3), `NO_COLOR` where it is none of them."""
        shift = 8 - BITS
        red, green, blue = (rgb[..., channel].astype(np.intp) >> shift for channel in range(3))
        labels: NDArray[np.uint8] = self._labels[(red << 2 * BITS) | (green << BITS) | blue]
        return labels


def find_near_colors(palette: Array) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """(256, 256) whether pixels of one surface of a palette (k, 3) may be labelled as another one.

    Also (256,) the number of the chain of such colours to which each belongs.
    """
    return _relate_colors(np.asarray(palette, np.float64).tobytes())


@lru_cache(maxsize=8)
def _relate_colors(palette_bytes: bytes) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    palette = np.frombuffer(palette_bytes).reshape(-1, 3)
    near = np.eye(256, dtype=np.bool_)
    for index, color in enumerate(palette):
        near[: len(palette), index] = _measure(np.maximum(palette, DIM), np.maximum(color, DIM)) < NEAR
    near |= near.T
    _, chains = connected_components(csr_array(near, dtype=np.int8), directed=False)
    near.flags.writeable = chains.flags.writeable = False  # every look shares them
    return near, chains


def is_among(labels: NDArray[np.uint8], colors: Iterable[int]) -> NDArray[np.bool_]:
    """(...,) whether a label is one of some colours."""
    table = np.zeros(256, np.bool_)
    table[list(colors)] = True
    found: NDArray[np.bool_] = table[labels]
    return found


def _measure(grid: Array, point: Array) -> Array:
    """Difference of hue and saturation, and, less, of brightness."""
    brightness, own = grid[:, 0] + grid[:, 1] + grid[:, 2], point.sum()
    red, green, blue = (grid[:, each] / brightness - point[each] / own for each in range(3))
    lightness = np.abs(brightness - own) / 3.0
    return np.asarray(np.sqrt(red * red + green * green + blue * blue) + 0.15 * lightness)


class Colorless:
    """Labels every pixel with the one colour of an inventory that knows none."""

    def label(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(h, w) zeros."""
        return np.zeros(rgb.shape[:2], dtype=np.uint8)


class DetectorSegmenter:
    """A segmenter that queries a detector with the inventory's words (`red cube`)."""

    def __init__(self, detector: Detector, inventory: Inventory) -> None:
        self._detector = detector
        self._colors = {
            f"{item.template.color} {item.template.kind}".strip(): item.colors[0] for item in inventory.objects.values()
        }

    def label(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(h, w) palette index of each pixel of (h, w, 3); raises ExecutionError with the detector's code."""
        labels = np.full(rgb.shape[:2], NO_COLOR, dtype=np.uint8)
        for found in reversed(self._detector.detect(rgb, tuple(self._colors))):  # the best last, on top
            left, top, width, height = found.box
            within = np.zeros(labels.shape, dtype=np.bool_)
            within[top : top + height, left : left + width] = True
            labels[within if found.mask is None else within & found.mask] = self._colors[found.label]
        return labels
