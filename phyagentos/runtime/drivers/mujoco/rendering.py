"""Pictures of a world by MuJoCo's own graphics, in software where there is no screen: for people, and for sensors.

Upstream: `world`, `simulated_camera`. MuJoCo chooses its graphics by MUJOCO_GL when it is imported. A machine without
graphics gives an empty picture with the reason, or no frame with a code; never an error.
"""

import io
from typing import Any

import mujoco
import numpy as np

from phyagentos.errors import ExecutionError
from phyagentos.runtime.drivers.mujoco.static_depth_cache import VISIBLE_GROUPS, Picture
from phyagentos.runtime.models.camera_model import Array, Lens, Pixels, Viewpoint
from phyagentos.runtime.targets.wire import Artefact, ToolResult

_MAX_WIDTH, _MAX_HEIGHT = 1920, 1440
_FAR = 0.99  # of the far plane: beyond it nothing was drawn


def render_png(model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int) -> ToolResult:
    """One picture, as the artefact `picture.png`; none where this machine cannot draw, with the reason.

    Args:
        model: Compiled model.
        data: State to show; only poses are read.
        camera: Name of a camera of the model.
        width: Pixels.
        height: Pixels.
    """
    names = [model.camera(index).name for index in range(model.ncam)]
    if camera not in names:
        return ToolResult({}, f"no camera {camera!r}; there are {', '.join(names) or 'none'}")
    width, height = min(width, _MAX_WIDTH), min(height, _MAX_HEIGHT)
    _make_room(model, width, height)
    try:
        with mujoco.Renderer(model, height, width) as renderer:
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, camera, _make_options())
            return ToolResult({"picture.png": Artefact("image/png", _encode(renderer.render()))})
    except Exception as error:  # graphics drivers raise what they like
        return ToolResult({}, f"{type(error).__name__}: {error}")


class GraphicsCaster:
    """Draws what `ray_cast.RayCaster` casts: shadows, gloss and textures included.

    Args:
        model: Compiled model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._renderers: dict[tuple[int, int], mujoco.Renderer] = {}

    def cast(
        self,
        data: mujoco.MjData,
        lens: Lens,
        viewpoint: Viewpoint,
        far_m: float,
        pixels: Pixels | None = None,
        *,
        still: bool = False,
    ) -> Picture:
        """One picture; the arguments are those of `RayCaster.cast`.

        Raises:
            ExecutionError: `NO_GRAPHICS` when this machine cannot draw.
        """
        try:
            rgb, depth = self._draw(data, lens, viewpoint)
        except Exception as error:  # graphics drivers raise what they like
            raise ExecutionError("NO_GRAPHICS", f"{type(error).__name__}: {error}") from error
        far = min(far_m, _FAR * float(self._model.vis.map.zfar * self._model.stat.extent))
        depth = np.where(depth < far, depth, np.float32(np.inf))
        picture = Picture(rgb.astype(np.float32) / np.float32(255.0), depth, _compute_incidence(depth, lens))
        if pixels is None:
            return picture
        return Picture(picture.rgb[pixels][None], picture.depth_m[pixels][None], picture.incidence[pixels][None])

    def _draw(self, data: mujoco.MjData, lens: Lens, viewpoint: Viewpoint) -> tuple[Any, Any]:
        size = (lens.width, lens.height)
        if size not in self._renderers:
            self.close()
            _make_room(self._model, *size)
            self._renderers[size] = mujoco.Renderer(self._model, lens.height, lens.width)
        renderer = self._renderers[size]
        renderer.update_scene(data, -1, _make_options())
        for camera in renderer.scene.camera:
            _place(camera, lens, viewpoint)
        renderer.disable_depth_rendering()
        rgb = np.array(renderer.render())
        renderer.enable_depth_rendering()
        return rgb, np.array(renderer.render())

    def close(self) -> None:
        """Let go of the graphics."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()


def _place(camera: mujoco.MjvGLCamera, lens: Lens, viewpoint: Viewpoint) -> None:
    """Let a camera of the graphics stand and open as ours does."""
    near = camera.frustum_near
    left, right = -lens.cx / lens.fx, (lens.width - lens.cx) / lens.fx
    camera.pos, camera.forward, camera.up = (
        viewpoint.position_m,
        viewpoint.rotation[:, 2],
        -viewpoint.rotation[:, 1],
    )
    camera.frustum_center, camera.frustum_width = near * (left + right) / 2, near * (right - left) / 2
    camera.frustum_top, camera.frustum_bottom = near * lens.cy / lens.fy, -near * (lens.height - lens.cy) / lens.fy


def _compute_incidence(depth: Any, lens: Lens) -> Any:
    """(height, width) cosine between ray and surface, from the slope of the depth."""
    rays = lens.compute_rays().reshape(lens.height, lens.width, 3)
    points: Array = rays * np.where(np.isfinite(depth), depth, 0.0)[..., None]
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(rays, axis=-1)
    cosines = np.abs(np.einsum("hwi,hwi->hw", normals, rays)) / np.maximum(lengths, 1e-12)
    return np.where(np.isfinite(depth), cosines, 0.0).astype(np.float32)


def _make_room(model: mujoco.MjModel, width: int, height: int) -> None:
    """Let the off-screen buffer hold a picture of this size."""
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)


def _make_options() -> mujoco.MjvOption:
    options = mujoco.MjvOption()
    options.geomgroup[:] = VISIBLE_GROUPS
    return options


def _encode(pixels: Any) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()
