"""Boxes of meshes: one a convex piece, and stacks of columns of what is concave."""

from collections.abc import Iterator
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Box = tuple[Array, Array]  # the lower and the upper corner
CELL_M = 0.03  # greatest side of a column
NEAR_M = 0.003  # lines that are nearer to each other are one
THIN_M = 0.001  # less is no solid


def read_mesh(path: Path) -> list[tuple[Array, NDArray[np.int64]]]:
    """Vertices (n, 3) and triangles (m, 3) of each piece of an OBJ, or of a binary STL."""
    if path.suffix.lower() == ".stl":
        data = path.read_bytes()[84:]
        rows = np.frombuffer(data, dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])["v"]
        return [(rows.reshape(-1, 3).astype(np.float64), np.arange(rows.shape[0] * 3).reshape(-1, 3))]
    vertices: list[list[float]] = []
    pieces: list[list[list[int]]] = []
    for kind, *rest in (line.split() for line in path.read_text().splitlines() if line.strip()):
        if kind == "v":
            vertices.append([float(each) for each in rest[:3]])
        elif kind == "o":
            pieces.append([])
        elif kind == "f":
            corners = [int(each.split("/")[0]) - 1 for each in rest]
            pieces[-1] += [[corners[0], b, c] for b, c in pairwise(corners[1:])]
    return [(np.array(vertices), np.array(piece)) for piece in pieces]


def bound(vertices: Array, triangles: NDArray[np.int64]) -> Box:
    """The box around a piece."""
    points = vertices[triangles.ravel()]
    return points.min(axis=0), points.max(axis=0)


def fill(vertices: Array, triangles: NDArray[np.int64]) -> list[Box]:
    """Boxes that fill a closed mesh, whose z axis is upwards: columns as high as it is over their middles."""
    x, y = (_draw_lines(vertices[:, axis]) for axis in range(2))
    corners = vertices[triangles]
    rows: dict[tuple[Any, ...], list[tuple[float, float]]] = {}
    for y_low, y_high in pairwise(y):
        columns = [(_cross(corners, (a + b) / 2.0, (y_low + y_high) / 2.0), a, b) for a, b in pairwise(x)]
        for spans, run in groupby(columns, key=lambda each: each[0]):
            run_x = [(a, b) for _, a, b in run]
            for span in spans:
                rows.setdefault((run_x[0][0], run_x[-1][1], *span), []).append((y_low, y_high))
    return [box for key, found in rows.items() for box in _join(key, found)]


def _join(key: tuple[float, ...], rows: list[tuple[float, float]]) -> Iterator[Box]:
    """Rows of the same columns as far as they touch."""
    x_low, x_high, z_low, z_high = key
    low = rows[0][0]
    for (_, end), (begin, _) in pairwise([*rows, (np.inf, np.inf)]):
        if begin > end:
            yield np.array((x_low, low, z_low)), np.array((x_high, end, z_high))
            low = begin


def _draw_lines(values: Array) -> list[float]:
    """Where a side of a box may be: at vertices, and between them."""
    lines = [float(values.min())]
    for value in np.unique(values):
        if value - lines[-1] > NEAR_M:
            count = int(np.ceil((value - lines[-1]) / CELL_M))
            lines += np.linspace(lines[-1], value, count + 1)[1:].tolist()
    return lines


def _cross(corners: Array, x: float, y: float) -> tuple[tuple[float, float], ...]:
    """Spans of height that a vertical line has inside triangles (n, 3, 3)."""
    point = np.array((x + 1.7e-5, y + 2.3e-5))
    a, b, c = (corners[:, index, :2] - point for index in range(3))
    weights = np.stack([_area(b, c), _area(c, a), _area(a, b)], axis=1)
    hit = np.all(weights > 0.0, axis=1) | np.all(weights < 0.0, axis=1)
    shares = weights[hit] / weights[hit].sum(axis=1, keepdims=True)
    heights = np.sort((shares * corners[hit, :, 2]).sum(axis=1)).round(4).tolist()
    return tuple((low, high) for low, high in zip(heights[::2], heights[1::2], strict=False) if high - low > THIN_M)


def _area(a: Array, b: Array) -> Array:
    found: Array = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return found
