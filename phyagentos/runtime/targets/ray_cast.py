"""The back end that needs no graphics: one ray for each pixel, cast by MuJoCo through the visible solids.

Upstream: `simulated_camera`. The state is only read; its poses must be computed (`mj_kinematics`). Colour is the
material's, lit by Lambert's law: no shadows, no gloss, and a texture counts with its mean.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.runtime.targets.camera_model import Array, Lens, Viewpoint

Single = NDArray[np.float32]
VISIBLE_GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)  # group 3 holds collision solids
SKY = np.array([0.7, 0.76, 0.82], dtype=np.float32)  # where nothing is hit


@dataclass(frozen=True, slots=True)
class Picture:
    """What a perfect camera sees.

    Attributes:
        rgb: (height, width, 3) 0..1.
        depth_m: (height, width) along z; inf where nothing is.
        incidence: (height, width) cosine between the ray and the surface's normal; 0 where nothing is.
    """

    rgb: Single
    depth_m: Single
    incidence: Single


class RayCaster:
    """Casts pictures of one model.

    Args:
        model: Compiled model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._colors = _read_colors(model)  # (n_geoms + 1, 3), the last one for nothing
        self._lights = [light for light in range(model.nlight) if model.light_active[light]]
        head = model.vis.headlight
        self._ambient, self._head = np.array(head.ambient, np.float32), np.array(head.diffuse, np.float32)
        self._rays: dict[Lens, tuple[Array, Array]] = {}

    def cast(self, data: mujoco.MjData, lens: Lens, viewpoint: Viewpoint, far_m: float) -> Picture:
        """One picture.

        Args:
            data: State with computed poses.
            lens: And window.
            viewpoint: `world_T_camera`.
            far_m: Depth beyond which nothing needs to be found.
        """
        rays, lengths = self._get_rays(lens)
        directions = rays @ viewpoint.rotation.T  # (n, 3) unit vectors in the world
        n = len(directions)
        geoms, distances, normals = np.empty(n, np.int32), np.empty(n), np.empty(3 * n)
        cutoff = far_m * float(lengths.max())
        mujoco.mj_multiRay(
            self._model, data, viewpoint.position_m, directions.ravel(), VISIBLE_GROUPS, True, -1,
            geoms, distances, normals, n, cutoff,
        )  # fmt: skip
        hit = geoms >= 0
        rays32, facing = directions.astype(np.float32), normals.astype(np.float32).reshape(-1, 3)
        along = np.where(hit, distances, 0.0).astype(np.float32)
        cosines = np.where(hit, -np.einsum("ij,ij->i", rays32, facing), np.float32(0.0))
        facing *= np.where(cosines < 0.0, np.float32(-1.0), np.float32(1.0))[:, None]  # a ray that starts in a solid
        cosines = np.abs(cosines)
        points = viewpoint.position_m.astype(np.float32) + rays32 * along[:, None]
        rgb = np.minimum(self._colors[geoms] * self._light(data, points, facing, cosines), np.float32(1.0))
        rgb[~hit] = SKY
        depth = np.where(hit, along / lengths.astype(np.float32), np.float32(np.inf))
        shape = (lens.height, lens.width)
        return Picture(rgb.reshape(*shape, 3), depth.reshape(shape), cosines.reshape(shape))

    def _get_rays(self, lens: Lens) -> tuple[Array, Array]:
        """(n, 3) unit vectors and (n,) lengths of the rays with z = 1; kept, since a camera's lens does not change."""
        if lens not in self._rays:
            if len(self._rays) > 32:  # windows that follow a thing are all different
                self._rays.clear()
            rays = lens.compute_rays()
            lengths = np.linalg.norm(rays, axis=1)
            self._rays[lens] = (rays / lengths[:, None], lengths)
        return self._rays[lens]

    def _light(self, data: mujoco.MjData, points: Single, normals: Single, facing: Single) -> Single:
        """(n, 3) light that each point sends back: ambient, a lamp at the camera, and the scene's lamps."""
        model = self._model
        light: Single = self._ambient + self._head * facing[:, None]
        for index in self._lights:
            direction = data.light_xdir[index].astype(np.float32)
            if model.light_type[index] == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
                cosines = -(normals @ direction)
            else:
                towards = data.light_xpos[index].astype(np.float32) - points
                distances = np.sqrt(np.einsum("ij,ij->i", towards, towards))
                cosines = np.einsum("ij,ij->i", normals, towards) / distances
                if model.light_type[index] == mujoco.mjtLightType.mjLIGHT_SPOT:
                    beam = np.cos(np.radians(float(model.light_cutoff[index])))
                    cosines = np.where(-(towards @ direction) >= beam * distances, cosines, 0.0)
            light += np.maximum(cosines, np.float32(0.0))[:, None] * model.light_diffuse[index]
            light += model.light_ambient[index]
        return light


def _read_colors(model: mujoco.MjModel) -> Single:
    """(n_geoms + 1, 3) colour of each geom, a texture by its mean; the last row is for no geom at all."""
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


def _compute_mean(model: mujoco.MjModel, texture: int) -> Array:
    """(3,) mean colour of a texture, 0..1."""
    channels = int(model.tex_nchannel[texture])
    start = int(model.tex_adr[texture])
    size = int(model.tex_width[texture]) * int(model.tex_height[texture]) * channels
    pixels = np.asarray(model.tex_data[start : start + size]).reshape(-1, channels)
    mean: Array = pixels[:, :3].mean(axis=0) / 255.0
    return mean if channels >= 3 else np.full(3, mean[0])
