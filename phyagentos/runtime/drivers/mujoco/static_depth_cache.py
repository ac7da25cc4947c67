"""A fixed camera's view of the fixed solids: cast once, and covered by what moves.

Only rays that pass near a movable solid are cast anew. The picture equals one that is cast whole, bit for bit.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.runtime.models.camera_model import Array, Lens, Pixels, Viewpoint

Single = NDArray[np.float32]
VISIBLE_GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)  # group 3 holds collision solids
AWAY_M = 1e4  # nothing is seen so far off
EDGE_PX = 1  # around the rectangle of a ball's picture, for rounding


@dataclass(frozen=True, slots=True)
class Shot:
    """A request for the picture of a perfect camera.

    Attributes:
        viewpoint: `world_T_camera`.
        far_m: Greatest depth that matters.
        pixels: Requested rows and columns, for a picture of one row (1, n); all when absent.
        still: Whether the camera never moves: its view of fixed solids is then cached.
    """

    lens: Lens
    viewpoint: Viewpoint
    far_m: float
    pixels: Pixels | None = None
    still: bool = False


@dataclass(frozen=True, slots=True)
class Picture:
    """The picture of a perfect camera.

    Attributes:
        rgb: (height, width, 3) 0..1.
        depth_m: (height, width) along z; inf where nothing is.
        incidence: (height, width) cosine between the ray and the surface's normal; 0 where nothing is.
    """

    rgb: Single
    depth_m: Single
    incidence: Single

    def reshape(self, shape: tuple[int, int]) -> "Picture":
        """The same pixels in another arrangement."""
        return Picture(self.rgb.reshape(*shape, 3), self.depth_m.reshape(shape), self.incidence.reshape(shape))


@dataclass(frozen=True, slots=True)
class Hits:
    """First hits of n rays: geoms (-1 for nothing), distances along the rays, normals (n, 3) of the surfaces."""

    geoms: NDArray[np.int32]
    distances_m: Array
    normals: Array

    def take(self, which: NDArray[np.bool_]) -> "Hits":
        """Of some of the rays."""
        return Hits(self.geoms[which], self.distances_m[which], self.normals[which])


@dataclass(frozen=True, slots=True)
class Rays:
    """Rays from one viewpoint: (n, 3) unit vectors in the world, cast up to `cutoff_m`."""

    viewpoint: Viewpoint
    directions: Array
    cutoff_m: float


@dataclass(frozen=True, slots=True)
class StaticDepthCache:
    """A picture of the fixed solids.

    Attributes:
        signature: Of the state of the fixed solids.
        lengths: (n,) of the rays with z = 1.
        hits: Of all rays.
        picture: Of (n,) pixels.
    """

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
        radii = np.array(model.geom_rbound[self._shown])
        self._radii_m = np.where(radii > 0.0, radii, np.inf)  # a plane has no end

    def sign_fixed(self, data: mujoco.MjData) -> bytes:
        """Poses of the fixed solids and the lamps: equal for two states as long as nothing fixed is moved."""
        parts = (data.geom_xpos[self._fixed], data.geom_xmat[self._fixed], data.light_xpos, data.light_xdir)
        return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)

    def send_away(self, data: mujoco.MjData) -> mujoco.MjData:
        """The same state without movable solids."""
        emptied = mujoco.MjData(self._model)
        mujoco.mj_copyData(emptied, self._model, data)
        emptied.geom_xpos[self._moving] = AWAY_M
        return emptied

    def find_pixels(self, data: mujoco.MjData, lens: Lens, viewpoint: Viewpoint) -> NDArray[np.intp]:
        """(m,) pixels of a picture, counted row by row, whose rays may hit a movable solid."""
        found = np.zeros((lens.height, lens.width), dtype=np.bool_)
        local = (data.geom_xpos[self._shown] - viewpoint.position_m) @ viewpoint.rotation
        left, right = _find_span(local[:, 0], local[:, 2], self._radii_m, lens.fx, lens.cx, lens.width)
        top, bottom = _find_span(local[:, 1], local[:, 2], self._radii_m, lens.fy, lens.cy, lens.height)
        for a, b, c, d in zip(top.tolist(), bottom.tolist(), left.tolist(), right.tolist(), strict=True):
            found[a:b, c:d] = True
        return np.flatnonzero(found)


def _find_span(
    across: Array, ahead: Array, radii: Array, focal: float, middle: float, size: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last-but-one pixel of the pictures of balls, along one side of a picture of some size."""
    away = np.hypot(across, ahead)
    angle = np.arctan2(across, ahead)
    half = np.where(away > radii, np.arcsin(np.minimum(radii / np.maximum(away, 1e-12), 1.0)), np.pi)  # pi: inside
    ends = np.clip([angle - half, angle + half], -1.57, 1.57)  # beyond, the ball reaches out of any picture
    low, high = np.clip(focal * np.tan(ends) + middle, -1e6, 1e6)
    first = np.clip(np.floor(low) - EDGE_PX, 0, size).astype(np.intp)
    return first, np.clip(np.ceil(high) + EDGE_PX, 0, size).astype(np.intp)


def shoot(model: mujoco.MjModel, data: mujoco.MjData, rays: Rays, *, fixed: bool = True) -> Hits:
    """First hit of each ray in a state with computed poses, fixed solids included or not."""
    n = len(rays.directions)
    hits = Hits(np.empty(n, np.int32), np.empty(n), np.empty((n, 3)))
    if n:
        mujoco.mj_multiRay(
            model, data, rays.viewpoint.position_m, rays.directions.ravel(), VISIBLE_GROUPS, fixed, -1,
            hits.geoms, hits.distances_m, hits.normals.ravel(), n, rays.cutoff_m,
        )  # fmt: skip
    return hits
