"""Pictures of a world by MuJoCo's own graphics, in software without a screen: for people, and for sensors.

MUJOCO_GL selects the graphics when MuJoCo is imported. A machine without graphics gives an empty picture with the
reason, or no frame with a code; never an error.
"""

import io
import threading

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.runtime.drivers.mujoco.static_depth_cache import VISIBLE_GROUPS, Picture, Shot
from phyagentos.runtime.models.camera_model import Array, Lens, Viewpoint
from phyagentos.runtime.targets.wire import Artefact, ToolResult

_MAX_WIDTH, _MAX_HEIGHT = 1920, 1440
_SHADOW_MAP = 2048  # pixels of its side
_DRAWING = threading.Lock()  # robots of one world are served by a thread each
_OPEN = threading.local()  # graphics belong to the thread that opened them
_FAR = 0.99  # of the far plane: beyond it nothing was drawn


def render_png(model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int) -> ToolResult:
    """One picture of a model's camera, as the artefact `picture.png`; without graphics none, with the reason."""
    names = [model.camera(index).name for index in range(model.ncam)]
    if camera not in names:
        return ToolResult({}, f"no camera {camera!r}; there are {', '.join(names) or 'none'}")
    try:
        with _DRAWING:
            renderer = _reuse_renderer(model, min(width, _MAX_WIDTH), min(height, _MAX_HEIGHT))
            shown = (camera, data.qpos.tobytes(), data.mocap_pos.tobytes(), data.mocap_quat.tobytes())
            if _OPEN.drawn[0] != shown:  # a session begins with the world that the one before has left
                mujoco.mj_camlight(model, data)
                renderer.update_scene(data, camera, _make_options())
                _OPEN.drawn = shown, _encode(renderer.render())
            return ToolResult({"picture.png": Artefact("image/png", _OPEN.drawn[1])})
    except Exception as error:  # graphics drivers raise what they like
        _OPEN.renderer = None  # what failed once is not used again
        return ToolResult({}, f"{type(error).__name__}: {error}")


def _reuse_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """The graphics of this thread, opened again for another world or size: to open them costs more than to draw."""
    kept: mujoco.Renderer | None = getattr(_OPEN, "renderer", None)
    if kept and kept.model is model and (kept.width, kept.height) == (width, height):
        return kept
    if kept:
        kept.close()
    _OPEN.renderer, _OPEN.drawn = None, (None, b"")
    _OPEN.renderer = _open_renderer(model, width, height)
    return _OPEN.renderer


def _open_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """Graphics for pictures for people: coarser shadows than the model's, of which a processor draws more at once."""
    _make_room(model, width, height)
    finest = model.vis.quality.shadowsize
    model.vis.quality.shadowsize = min(finest, _SHADOW_MAP)
    try:
        return mujoco.Renderer(model, height, width)
    finally:
        model.vis.quality.shadowsize = finest


class GraphicsCaster:
    """Draws what `ray_cast.RayCaster` casts: shadows, gloss and textures included; every surface is `ORDINARY`."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._renderers: dict[tuple[int, int], mujoco.Renderer] = {}

    def cast(self, data: mujoco.MjData, shot: Shot) -> Picture:
        """One picture of a state with computed poses.

        Raises:
            ExecutionError: `NO_GRAPHICS` when this machine cannot draw.
        """
        try:
            with _DRAWING:
                rgb, depth = self._draw(data, shot.lens, shot.viewpoint)
        except Exception as error:  # graphics drivers raise what they like
            raise ExecutionError("NO_GRAPHICS", f"{type(error).__name__}: {error}") from error
        far = min(shot.far_m, _FAR * float(self._model.vis.map.zfar * self._model.stat.extent))
        depth = np.where(depth < far, depth, np.float32(np.inf))
        colors, finish = rgb.astype(np.float32) / np.float32(255.0), np.zeros(depth.shape, np.uint8)
        picture = Picture(colors, depth, _compute_incidence(depth, shot.lens), finish)
        if (some := shot.pixels) is None:
            return picture
        return Picture(colors[some][None], depth[some][None], picture.incidence[some][None], finish[some][None])

    def shows_motion(self, data: mujoco.MjData, begin: mujoco.MjData, shot: Shot) -> bool:
        """Not known without drawing."""
        return True

    def _draw(
        self, data: mujoco.MjData, lens: Lens, viewpoint: Viewpoint
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
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
        """Release the graphics."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()


def _place(camera: mujoco.MjvGLCamera, lens: Lens, viewpoint: Viewpoint) -> None:
    """Set pose and opening of a camera of the graphics."""
    near = camera.frustum_near
    left, right = -lens.cx / lens.fx, (lens.width - lens.cx) / lens.fx
    camera.pos, camera.forward, camera.up = (viewpoint.position_m, viewpoint.rotation[:, 2], -viewpoint.rotation[:, 1])
    camera.frustum_center, camera.frustum_width = near * (left + right) / 2, near * (right - left) / 2
    camera.frustum_top, camera.frustum_bottom = near * lens.cy / lens.fy, -near * (lens.height - lens.cy) / lens.fy


def _compute_incidence(depth: NDArray[np.float32], lens: Lens) -> NDArray[np.float32]:
    """(height, width) cosine between ray and surface, from the slope of the depth."""
    rays = lens.compute_rays().reshape(lens.height, lens.width, 3)
    points: Array = rays * np.where(np.isfinite(depth), depth, 0.0)[..., None]
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(rays, axis=-1)
    cosines = np.abs(np.einsum("hwi,hwi->hw", normals, rays)) / np.maximum(lengths, 1e-12)
    return np.where(np.isfinite(depth), cosines, 0.0).astype(np.float32)


def _make_room(model: mujoco.MjModel, width: int, height: int) -> None:
    """Enlarge the off-screen buffer to this size."""
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)


def _make_options() -> mujoco.MjvOption:
    options = mujoco.MjvOption()
    options.geomgroup[:] = VISIBLE_GROUPS
    return options


def _encode(pixels: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()
