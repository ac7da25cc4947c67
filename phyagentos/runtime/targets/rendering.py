"""Pictures of a world, in software where there is no screen.

Upstream: `world`. MuJoCo chooses its graphics by MUJOCO_GL when it is imported. A machine without graphics gets an
empty picture with the reason, never an error: a picture is evidence for people, not for verdicts.
"""

import io
from typing import Any

import mujoco

from phyagentos.runtime.targets.wire import Picture

_MAX_WIDTH, _MAX_HEIGHT = 1920, 1440


def render_png(model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int) -> Picture:
    """One PNG.

    Args:
        model: Compiled model.
        data: State to show; only poses are read.
        camera: Name of a camera of the model.
        width: Pixels.
        height: Pixels.
    """
    names = [model.camera(index).name for index in range(model.ncam)]
    if camera not in names:
        return Picture(b"", f"no camera {camera!r}; there are {', '.join(names) or 'none'}")
    width, height = min(width, _MAX_WIDTH), min(height, _MAX_HEIGHT)
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    try:
        with mujoco.Renderer(model, height, width) as renderer:
            mujoco.mj_camlight(model, data)
            options = mujoco.MjvOption()
            options.geomgroup[3] = 0  # collision solids
            renderer.update_scene(data, camera, options)
            return Picture(_encode(renderer.render()))
    except Exception as error:  # graphics drivers raise what they like
        return Picture(b"", f"{type(error).__name__}: {error}")


def _encode(pixels: Any) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()
