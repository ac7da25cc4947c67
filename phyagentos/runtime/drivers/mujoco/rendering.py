"""Pictures of a world by MuJoCo's own graphics, in software without a screen: for people, and for sensors.

MUJOCO_GL selects the graphics when MuJoCo is imported. A machine without graphics gives an empty picture with the
reason, or no frame with a code; never an error.
"""

import io
import os
import threading
import weakref
from concurrent.futures import Future, ThreadPoolExecutor
from copy import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.runtime.drivers.mujoco.static_depth_cache import VISIBLE_GROUPS, Picture, Shot
from phyagentos.runtime.models.camera_model import Array, Lens, Viewpoint
from phyagentos.runtime.targets.wire import Artefact, ToolResult

_MAX_WIDTH, _MAX_HEIGHT = 1920, 1440
_SHADOW_MAP = 2048  # pixels of its side
_GIVES_WAY = 10  # nice value of what draws, and of the threads that its graphics start


def _give_way() -> None:
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), max(_GIVES_WAY, os.getpriority(os.PRIO_PROCESS, 0)))


# graphics belong to the thread that opened them: all are this one's
_DRAWING = ThreadPoolExecutor(1, "drawing", initializer=_give_way)
_FAR = 0.99  # of the far plane: beyond it nothing was drawn


def render_png(model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int) -> ToolResult:
    """One picture of a model's camera, as the artefact `picture.png`; without graphics none, with the reason."""
    return render_ahead(model, data, camera, width, height).result()


def render_ahead(
    model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int
) -> "Future[ToolResult]":
    """Begin a picture as `render_png` does, which then has it at once; `data` must stay as it is."""
    return _DRAWING.submit(_PICTURES.draw, model, data, camera, min(width, _MAX_WIDTH), min(height, _MAX_HEIGHT))


class _Pictures:
    """Pictures for people, drawn in the one thread of graphics; the latest is kept, and the graphics stay open."""

    def __init__(self) -> None:
        self._renderer: mujoco.Renderer | None = None
        self._model: mujoco.MjModel | None = None
        self._drawn: tuple[object, bytes] = None, b""

    def draw(self, model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int) -> ToolResult:
        names = [model.camera(index).name for index in range(model.ncam)]
        if camera not in names:
            return ToolResult({}, f"no camera {camera!r}; there are {', '.join(names) or 'none'}")
        try:
            renderer = self._reuse_renderer(model, width, height)
            shown = (camera, data.qpos.tobytes(), data.mocap_pos.tobytes(), data.mocap_quat.tobytes())
            if self._drawn[0] != shown:  # a session begins with the world that the one before has left
                mujoco.mj_camlight(model, data)
                renderer.update_scene(data, camera, _make_options())
                self._drawn = shown, _encode(renderer.render())
            return ToolResult({"picture.png": Artefact("image/png", self._drawn[1])})
        except Exception as error:  # graphics drivers raise what they like
            self._renderer = None  # what failed once is not used again
            return ToolResult({}, f"{type(error).__name__}: {error}")

    def _reuse_renderer(self, model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
        """The graphics, opened again for another world or size: to open them costs more than to draw."""
        kept = self._renderer
        if kept and self._model is model and (kept.width, kept.height) == (width, height):
            return kept
        if kept:
            kept.close()
        self._renderer, self._model, self._drawn = None, model, (None, b"")
        own = copy(model)  # that of the world is exported meanwhile
        _make_room(own, width, height)
        own.vis.quality.shadowsize = min(model.vis.quality.shadowsize, _SHADOW_MAP)  # a processor draws more at once
        self._renderer = mujoco.Renderer(own, height, width)
        return self._renderer


_PICTURES = _Pictures()


class GraphicsCaster:
    """Draws what `ray_cast.RayCaster` casts: shadows, gloss and textures included; every surface is `ORDINARY`."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._renderers: dict[tuple[int, int], mujoco.Renderer] = {}
        weakref.finalize(self, _DRAWING.submit, _close, self._renderers).atexit = False

    def cast(self, data: mujoco.MjData, shot: Shot) -> Picture:
        """One picture of a state with computed poses.

        Raises:
            ExecutionError: `NO_GRAPHICS` when this machine cannot draw.
        """
        try:
            rgb, depth = _DRAWING.submit(self._draw, data, shot.lens, shot.viewpoint).result()
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
            _close(self._renderers)
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


def _close(renderers: dict[tuple[int, int], mujoco.Renderer]) -> None:
    """Release graphics, in the thread that opened them."""
    for renderer in renderers.values():
        renderer.close()
    renderers.clear()


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
