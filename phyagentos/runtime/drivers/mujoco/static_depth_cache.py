"""A fixed camera's view of the fixed solids: cast once, and covered by what moves.

Only rays that pass near a movable solid are cast anew. The picture equals one that is cast whole, bit for bit.
"""

from dataclasses import dataclass
from math import asin, atan2, ceil, floor, hypot, pi, tan

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

from phyagentos.runtime.models.camera_model import Array, Lens, Pixels, Viewpoint

Single = NDArray[np.float32]
Finishes = NDArray[np.uint8]
ORDINARY, BLACK, GLASS = 0, 1, 2  # how a surface returns the light that depth is measured with
VISIBLE_GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)  # group 3 holds collision solids
AWAY_M = 1e4  # nothing is seen so far off
EDGE_PX = 1  # around the rectangle of a ball's picture, for rounding
FLAT_RAD = 1.57  # beyond, a ball reaches out of any picture
UNSEEN = 1e-4  # a move of a solid that no pixel shows [m], or of its rotation


@dataclass(frozen=True, slots=True)
class Shot:
    """A request for the picture of a perfect camera at `viewpoint`, `world_T_camera`.

    Attributes:
        far_m: Greatest depth that matters.
        pixels: Requested rows and columns, for a picture of one row (1, n); all when absent.
        still: Whether the camera never moves: its view of fixed solids is then cached.
        whole: Lens of the whole picture, of which this is a window; the same lens when absent.
        corner: Column and row of the window in it.
    """

    lens: Lens
    viewpoint: Viewpoint
    far_m: float
    pixels: Pixels | None = None
    still: bool = False
    whole: Lens | None = None
    corner: tuple[int, int] = (0, 0)

    def find_pixels(self) -> NDArray[np.intp]:
        """(n,) pixels of the whole picture, counted row by row."""
        width, (left, top) = (self.whole or self.lens).width, self.corner
        rows, columns = self.pixels or (np.arange(self.lens.height)[:, None], np.arange(self.lens.width))
        return np.ravel((rows + top) * width + (columns + left))


@dataclass(frozen=True, slots=True)
class Picture:
    """The picture of a perfect camera.

    Attributes:
        rgb: (height, width, 3) 0..1.
        depth_m: (height, width) along z; inf where nothing is.
        incidence: (height, width) cosine between the ray and the surface's normal; 0 where nothing is.
        finish: (height, width) `ORDINARY`, `BLACK` or `GLASS`.
    """

    rgb: Single
    depth_m: Single
    incidence: Single
    finish: Finishes

    def take(self, which: NDArray[np.intp]) -> "Picture":
        """A copy of some of its pixels, where these are in one row."""
        rgb = self.rgb.take(which, axis=0)
        return Picture(rgb, self.depth_m.take(which), self.incidence.take(which), self.finish.take(which))

    def reshape(self, shape: tuple[int, int]) -> "Picture":
        """The same pixels in another arrangement."""
        depth, incidence, finish = (
            self.depth_m.reshape(shape),
            self.incidence.reshape(shape),
            self.finish.reshape(shape),
        )
        return Picture(self.rgb.reshape(*shape, 3), depth, incidence, finish)


@dataclass(frozen=True, slots=True)
class Hits:
    """First hits of n rays: geoms (-1 for nothing), distances along the rays, normals (n, 3) of the surfaces."""

    geoms: NDArray[np.int32]
    distances_m: Array
    normals: Array


@dataclass(frozen=True, slots=True)
class Rays:
    """Rays from one viewpoint: (n, 3) unit vectors in the world, cast up to `cutoff_m`."""

    viewpoint: Viewpoint
    directions: Array
    cutoff_m: float


@dataclass(frozen=True, slots=True)
class StaticDepthCache:
    """A picture (n,) of the fixed solids in the state of a `signature`; `lengths` (n,) are of the rays with z = 1."""

    signature: bytes
    lens: Lens
    rays: Rays
    lengths: Array
    hits: Hits
    picture: Picture


class MovingSolids:
    """The movable solids of a model."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        moves = model.body_weldid[model.geom_bodyid] != 0
        visible = VISIBLE_GROUPS[np.clip(model.geom_group, 0, len(VISIBLE_GROUPS) - 1)] > 0
        self._fixed = np.flatnonzero(~moves)
        self._moving = np.flatnonzero(moves)
        self._shown = np.flatnonzero(moves & visible)
        self._radii_m = np.array(model.geom_rbound[self._shown])
        self._radii_m[self._radii_m <= 0.0] = np.inf  # a plane has no end

    def sign_fixed(self, data: mujoco.MjData) -> bytes:
        """Poses of the fixed solids and the lamps: equal for two states as long as nothing fixed is moved."""
        solids = (part.take(self._fixed, axis=0) for part in (data.geom_xpos, data.geom_xmat))
        return b"".join(part.tobytes() for part in (*solids, data.light_xpos, data.light_xdir))

    def send_away(self, data: mujoco.MjData) -> mujoco.MjData:
        """The same state without movable solids."""
        emptied = mujoco.MjData(self._model)
        mujoco.mj_copyData(emptied, self._model, data)
        emptied.geom_xpos[self._moving] = AWAY_M
        return emptied

    def find_moved(self, one: mujoco.MjData, other: mujoco.MjData) -> NDArray[np.intp]:
        """Which of the movable solids have moved visibly between two states."""
        parts = ((one.geom_xpos, other.geom_xpos), (one.geom_xmat, other.geom_xmat))
        changes = (np.abs(a.take(self._shown, axis=0) - b.take(self._shown, axis=0)).max(axis=1) for a, b in parts)
        return np.flatnonzero(np.maximum(*changes) > UNSEEN)

    def find_near(
        self,
        data: mujoco.MjData,
        lens: Lens,
        viewpoint: Viewpoint,
        wanted: NDArray[np.intp],
        among: NDArray[np.intp] | slice = slice(None),
    ) -> NDArray[np.intp]:
        """Indices of those of the `wanted` pixels of the whole picture whose rays may hit a movable solid."""
        view = viewpoint.position_m, viewpoint.rotation
        solids = data.geom_xpos[self._shown[among]], self._radii_m[among]
        form = (lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height)
        return np.flatnonzero(_find_near(wanted, form, view, solids))


@njit(cache=True, nogil=True)
def _find_span(across, ahead, radius, focal, middle, size):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """First pixel that a ball covers along one side of a picture of `size` pixels, and the one after its last."""
    away, angle = hypot(across, ahead), atan2(across, ahead)
    half = asin(radius / away) if away > radius else pi  # pi: inside
    low, high = max(angle - half, -FLAT_RAD), min(angle + half, FLAT_RAD)
    first, last = focal * tan(min(low, FLAT_RAD)) + middle, focal * tan(max(high, -FLAT_RAD)) + middle
    return max(floor(first) - EDGE_PX, 0), min(ceil(last) + EDGE_PX, size)


@njit(cache=True, nogil=True)
def _find_near(wanted, lens, view, solids):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Whether each ray is near: its pixel is in the rectangle of a solid's ball. Loops compile in half the time."""
    (places, radii), (eye, frame) = solids, view
    fx, fy, cx, cy, width, height = lens
    n, low, high, first, last = len(wanted), width, -1, height, -1
    rows, columns, found = np.empty(n, np.intp), np.empty(n, np.intp), np.zeros(n, np.bool_)
    for i in range(n):
        rows[i], columns[i] = wanted[i] // width, wanted[i] % width
        low, high = min(low, columns[i]), max(high, columns[i])
        first, last = min(first, rows[i]), max(last, rows[i])
    for k in range(len(radii)):
        a, b, c = places[k, 0] - eye[0], places[k, 1] - eye[1], places[k, 2] - eye[2]
        x = a * frame[0, 0] + b * frame[1, 0] + c * frame[2, 0]
        y = a * frame[0, 1] + b * frame[1, 1] + c * frame[2, 1]
        z = a * frame[0, 2] + b * frame[1, 2] + c * frame[2, 2]
        left, right = _find_span(x, z, radii[k], fx, cx, width)
        top, bottom = _find_span(y, z, radii[k], fy, cy, height)
        if left < right and left <= high and right > low and top < bottom and top <= last and bottom > first:
            for i in range(n):
                found[i] |= left <= columns[i] < right and top <= rows[i] < bottom
    return found


def cast_rays(model: mujoco.MjModel, data: mujoco.MjData, rays: Rays, *, fixed: bool = True) -> Hits:
    """First hit of each ray in a state with computed poses, fixed solids included or not."""
    n = len(rays.directions)
    hits = Hits(np.empty(n, np.int32), np.empty(n), np.empty((n, 3)))
    if n:
        mujoco.mj_multiRay(
            model, data, rays.viewpoint.position_m, rays.directions.ravel(), VISIBLE_GROUPS, fixed, -1,
            hits.geoms, hits.distances_m, hits.normals.ravel(), n, rays.cutoff_m,
        )  # fmt: skip
    return hits
