"""The back end without graphics: one ray for each pixel, cast by MuJoCo through the visible solids.

The state, with computed poses (`mj_kinematics`), is only read. Colour is the material's, lit by Lambert's law: no
shadows, no gloss, and a texture counts with its mean.
"""

from functools import lru_cache

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

from phyagentos.runtime.drivers.mujoco.static_depth_cache import (
    BLACK,
    GLASS,
    ORDINARY,
    Finishes,
    Hits,
    MovingSolids,
    Picture,
    Rays,
    Shot,
    Single,
    StaticDepthCache,
    cast_rays,
)
from phyagentos.runtime.models.camera_model import Array, Lens

KEPT_PX = 4096  # a smaller picture is cast as fast
CACHES_KEPT = 8  # of some megabytes each
BLACK_BELOW = 0.12  # of the brightest channel of a surface's own colour
GLASSY = 0.8  # product of gloss and sharpness of a material, from which on light is mirrored rather than returned
SKY = np.array([0.7, 0.76, 0.82], dtype=np.float32)  # where nothing is hit
DIRECTIONAL, SPOT = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL), int(mujoco.mjtLightType.mjLIGHT_SPOT)


class RayCaster:
    """Casts pictures of one model."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._colors = _read_colors(model)  # (n_geoms + 1, 3), the last one for nothing
        self._finishes = _read_finishes(model, self._colors)
        self._lights = np.flatnonzero(model.light_active)
        self._kinds = model.light_type[self._lights].astype(np.intp)
        openings = np.cos(np.radians(model.light_cutoff[self._lights].astype(np.float64)))
        self._shine = openings, model.light_diffuse[self._lights], model.light_ambient[self._lights]
        head = model.vis.headlight
        self._ambient, self._head = np.array(head.ambient, np.float32), np.array(head.diffuse, np.float32)
        self._moving = MovingSolids(model)
        self._static_caches: dict[tuple[Lens, bytes, bytes, float], StaticDepthCache] = {}

    def cast(self, data: mujoco.MjData, shot: Shot) -> Picture:
        """One picture of a state with computed poses."""
        lens, pixels = shot.lens, shot.pixels
        shape = (lens.height, lens.width) if pixels is None else (1, len(pixels[0]))
        if shot.still and (cache := self._get_cache(data, shot)) is not None:
            return self._cover(cache, data, shot).reshape(shape)
        rays, lengths = _compute_rays(lens) if pixels is None else _normalise(lens.compute_rays(pixels))
        beam = Rays(shot.viewpoint, rays @ shot.viewpoint.rotation.T, shot.far_m * float(lengths.max()))
        return self._paint(data, beam, lengths, cast_rays(self._model, data, beam)).reshape(shape)

    def shows_motion(self, data: mujoco.MjData, begin: mujoco.MjData, shot: Shot) -> bool:
        """Whether a picture may show that something moved since `begin`; a camera that moves shows it always."""
        cache = self._get_cache(data, shot) if shot.still else None
        if cache is None or self._moving.sign_fixed(begin) != cache.signature:
            return True
        wanted, moved = shot.find_pixels(), self._moving.find_moved(data, begin)
        return any(
            len(self._moving.find_near(each, cache.lens, shot.viewpoint, wanted, moved)) for each in (data, begin)
        )

    def _paint(self, data: mujoco.MjData, rays: Rays, lengths: Array, hits: Hits) -> Picture:
        """Colours, depths and cosines of (n,) pixels from the hits of their rays."""
        n = len(lengths)
        blank = np.full(n, np.inf, np.float32), np.zeros(n, np.float32), np.zeros(n, np.uint8)
        picture = Picture(np.tile(SKY, (n, 1)), *blank)
        self._paint_on(picture, np.arange(n), data, rays, lengths, hits)
        return picture

    def _paint_on(
        self, picture: Picture, places: NDArray[np.intp], data: mujoco.MjData, rays: Rays, lengths: Array, hits: Hits
    ) -> None:
        """Paints what n rays hit on these pixels (n,) of a picture of one row."""
        where, towards = (part[self._lights].astype(np.float32) for part in (data.light_xpos, data.light_xdir))
        _light_up(
            (picture.rgb, picture.depth_m, picture.incidence, picture.finish), places, rays.viewpoint.position_m,
            rays.directions, lengths, (hits.geoms, hits.distances_m, hits.normals), (self._colors, self._finishes),
            self._ambient, self._head, (self._kinds, where, towards, *self._shine),
        )  # fmt: skip

    def _get_cache(self, data: mujoco.MjData, shot: Shot) -> StaticDepthCache | None:
        """A fixed camera's view of the fixed solids; cast anew by a whole picture where those were moved after all."""
        lens, viewpoint = shot.whole or shot.lens, shot.viewpoint
        key = (lens, viewpoint.position_m.tobytes(), viewpoint.rotation.tobytes(), shot.far_m)
        signature = self._moving.sign_fixed(data)
        kept = self._static_caches.get(key)
        if kept is None or kept.signature != signature:
            if shot.pixels is not None or shot.lens != lens or lens.width * lens.height < KEPT_PX:
                return None
            if len(self._static_caches) >= CACHES_KEPT:
                self._static_caches.clear()
            rays, lengths = _compute_rays(lens)
            beam = Rays(viewpoint, rays @ viewpoint.rotation.T, shot.far_m * float(lengths.max()))
            emptied = self._moving.send_away(data)
            hits = cast_rays(self._model, emptied, beam)
            kept = StaticDepthCache(signature, lens, beam, lengths, hits, self._paint(emptied, beam, lengths, hits))
            self._static_caches[key] = kept
        return kept

    def _cover(self, cache: StaticDepthCache, data: mujoco.MjData, shot: Shot) -> Picture:
        """The fixed solids, with the moving ones in front."""
        rays, behind, wanted = cache.rays, cache.hits, shot.find_pixels()
        picture = cache.picture.take(wanted)
        near = self._moving.find_near(data, cache.lens, rays.viewpoint, wanted)
        if len(near):
            where = wanted[near]
            beam = Rays(rays.viewpoint, rays.directions.take(where, axis=0), rays.cutoff_m)
            hits = cast_rays(self._model, data, beam, fixed=False)
            _hide(hits.geoms, hits.distances_m, behind.geoms, behind.distances_m, where)
            self._paint_on(picture, near, data, beam, cache.lengths.take(where), hits)
        return picture


@njit(cache=True, inline="always")
def _dot(x, y, z, a, b, c):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    return x * a + y * b + z * c


@njit(cache=True, nogil=True)
def _hide(geoms, distances, fixed, fixed_m, where):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Removes hits behind fixed solids; of two at one distance, the solid of the lower number is hit."""
    for k, i in enumerate(where):
        is_behind = fixed[i] >= 0 and distances[k] >= fixed_m[i]
        if is_behind and (distances[k] > fixed_m[i] or fixed[i] < geoms[k]):
            geoms[k] = -1


@njit(cache=True, nogil=True)
def _light_up(picture, wanted, eye, rays, lengths, hits, looks, ambient, head, lamps):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Pixel by pixel, in single precision: the bits of a pixel do not depend on the others."""
    (rgb, depth, incidence, finish), zero, one = picture, np.float32(0.0), np.float32(1.0)
    colors, finishes = looks
    kinds, places, directions, openings, diffuse, dim = lamps
    light = np.empty(3, np.float32)
    for i, pixel in enumerate(wanted):
        geom = hits[0][i]
        if geom < 0:
            continue
        along = np.float32(hits[1][i])
        x, y, z = np.float32(rays[i, 0]), np.float32(rays[i, 1]), np.float32(rays[i, 2])
        a, b, c = np.float32(hits[2][i, 0]), np.float32(hits[2][i, 1]), np.float32(hits[2][i, 2])
        cosine = -_dot(x, y, z, a, b, c)
        if cosine < zero:  # a ray that starts in a solid
            a, b, c, cosine = -a, -b, -c, -cosine
        x, y, z = np.float32(eye[0]) + x * along, np.float32(eye[1]) + y * along, np.float32(eye[2]) + z * along
        for channel in range(3):
            light[channel] = ambient[channel] + head[channel] * cosine
        for lamp in range(len(kinds)):
            p, q, r = directions[lamp, 0], directions[lamp, 1], directions[lamp, 2]
            if kinds[lamp] == DIRECTIONAL:
                shining = -_dot(a, b, c, p, q, r)
            else:
                u, v, w = places[lamp, 0] - x, places[lamp, 1] - y, places[lamp, 2] - z
                distance = np.sqrt(_dot(u, v, w, u, v, w))
                shining = _dot(a, b, c, u, v, w) / distance
                if kinds[lamp] == SPOT and np.float64(-_dot(u, v, w, p, q, r)) < openings[lamp] * distance:
                    shining = zero
            for channel in range(3):
                light[channel] = light[channel] + max(shining, zero) * diffuse[lamp, channel] + dim[lamp, channel]
        for channel in range(3):
            rgb[pixel, channel] = min(colors[geom, channel] * light[channel], one)
        depth[pixel], incidence[pixel], finish[pixel] = along / np.float32(lengths[i]), cosine, finishes[geom]


@lru_cache(maxsize=32)  # windows that follow an object are all different
def _compute_rays(lens: Lens) -> tuple[Array, Array]:
    return _normalise(lens.compute_rays())


def _normalise(rays: Array) -> tuple[Array, Array]:
    """(n, 3) unit vectors and (n,) lengths."""
    lengths = np.linalg.norm(rays, axis=1)
    return rays / lengths[:, None], lengths


def _read_colors(model: mujoco.MjModel) -> Single:
    """(n_geoms + 1, 3) colour of each geom, a texture by its mean; the last row is for no geom."""
    means = [_compute_mean(model, texture) for texture in range(model.ntex)]
    colors = np.ones((model.ngeom + 1, 3), np.float32)
    role = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
    for geom in range(model.ngeom):
        material = int(model.geom_matid[geom])
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        colors[geom] = rgba[:3]
        texture = int(model.mat_texid[material][role]) if material >= 0 else -1
        if texture >= 0:
            colors[geom] *= means[texture]
    return colors


def _read_finishes(model: mujoco.MjModel, colors: Single) -> Finishes:
    """(n_geoms + 1,) how each geom returns light; glass is glossy and sharp, or lets light through."""
    finishes = np.where(colors.max(axis=1) < BLACK_BELOW, BLACK, ORDINARY).astype(np.uint8)
    for geom, material in enumerate(model.geom_matid.tolist()):
        if material >= 0:
            gloss = float(model.mat_specular[material] * model.mat_shininess[material])
            finishes[geom] = GLASS if gloss >= GLASSY or model.mat_rgba[material, 3] < 1.0 else finishes[geom]
    return finishes


def _compute_mean(model: mujoco.MjModel, texture: int) -> Array:
    """(3,) mean colour of a texture, 0..1."""
    channels = int(model.tex_nchannel[texture])
    start = int(model.tex_adr[texture])
    size = int(model.tex_width[texture]) * int(model.tex_height[texture]) * channels
    pixels = np.asarray(model.tex_data[start : start + size]).reshape(-1, channels)
    mean: Array = pixels[:, :3].mean(axis=0) / 255.0
    return mean if channels >= 3 else np.full(3, mean[0])
