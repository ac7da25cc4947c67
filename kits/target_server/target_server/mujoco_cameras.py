"""RGB-D cameras of a compiled MuJoCo model, drawn when they are asked for: colours, and depth along the axis in metres.

`MUJOCO_GL` selects the graphics when MuJoCo is imported; `egl` needs no screen. Nothing of what is drawn says to which
body a pixel belongs. Poses are in the frame of a root that stands still.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from target_server.body import Picture, Window
from target_server.mujoco_objects import Array, to_quaternion
from target_server.wire import Refusal

OPENCV = np.diag((1.0, -1.0, -1.0))  # MuJoCo's cameras look along -z with y up
VISIBLE_GROUPS = (1,)
HIDDEN_GROUP = 5
GEOMS_MAX = 4000
LOOK_YAWS = 8
LOOK_PITCHES = (-40.0, -80.0)  # [deg], as cameras look at a table
LOOK_PX = 96
LEVELS, LEAST_SHARE = 6, 0.01  # of each channel; of a colour that is kept


@dataclass(frozen=True)
class Sensor:
    """One camera of the model.

    Attributes:
        camera: Its name in the model.
        range_m: Least and greatest depth that is measured; outside of it there is none.
    """

    camera: str
    width: int
    height: int
    range_m: tuple[float, float]


@dataclass
class Cameras:
    """The cameras of one model.

    Attributes:
        model: Compiled.
        sensors: By the names by which they are asked for.
        root_m: (3,) where the root is in the model's world; `root` (3, 3) is how it is turned.
    """

    model: Any
    sensors: Mapping[str, Sensor]
    root_m: Array
    root: Array
    _graphics: "_Graphics | None" = None

    def capture(
        self, data: Any, time_s: float, names: Sequence[str], windows: Mapping[str, Window], every: int
    ) -> list[Picture]:
        """The pictures of a state with computed poses; raises `Refusal` `REQUEST_INVALID` or `REQUEST_INVALID`."""
        unknown = [name for name in (*names, *windows) if name not in self.sensors]
        if unknown:
            raise Refusal("REQUEST_INVALID", f"no camera {unknown[0]!r}; there are {', '.join(self.sensors)}")
        return [self._take(data, time_s, name, windows.get(name), every) for name in names or self.sensors]

    def photograph(self, data: Any, geoms: Sequence[int], center_m: Array, radius_m: float) -> list[list[list[float]]]:
        """The colours of these geoms, seen alone from each side in the light of the scene.

        A list a side, with a row a colour: red, green, blue and share, of 0 to 1.
        """
        groups = self.model.geom_group.copy()
        self.model.geom_group[np.setdiff1d(np.arange(self.model.ngeom), geoms)] = HIDDEN_GROUP
        camera = mujoco.MjvCamera()
        camera.lookat[:], camera.distance = center_m, 4.0 * radius_m
        sides = []
        try:
            for camera.elevation in LOOK_PITCHES:
                for camera.azimuth in np.arange(LOOK_YAWS) * 360.0 / LOOK_YAWS:
                    rgb, depth_m = self._draw(data, camera, (LOOK_PX, LOOK_PX))
                    sides.append(_count_colors(rgb[depth_m < 8.0 * radius_m] / 255.0))
        finally:
            self.model.geom_group[:] = groups
        return [side for side in sides if side]

    def close(self) -> None:
        """Release the graphics."""
        if self._graphics is not None:
            self._graphics.close()
        self._graphics = None

    def _take(self, data: Any, time_s: float, name: str, window: Window | None, every: int) -> Picture:
        sensor = self.sensors[name]
        left, top, width, height = window or (0, 0, sensor.width, sensor.height)
        rows, columns = height // max(every, 1), width // max(every, 1)
        is_inside = min(left, top) >= 0 and left + width <= sensor.width and top + height <= sensor.height
        if not is_inside or every < 1 or every % 2 == 0 or min(rows, columns) < 1:
            size = f"{sensor.width} x {sensor.height} pixels"
            raise Refusal("REQUEST_INVALID", f"every {every} of a window {window} of a picture of {size}")
        rgb, depth_m = self._draw(data, sensor.camera, (sensor.height, sensor.width))
        some = np.ix_(top + every // 2 + every * np.arange(rows), left + every // 2 + every * np.arange(columns))
        near_m, far_m = sensor.range_m
        depth_m = np.where((near_m <= depth_m) & (depth_m <= far_m), depth_m, np.float32(np.nan))
        number = self.model.camera(sensor.camera).id
        focal = sensor.height / 2.0 / np.tan(np.radians(float(self.model.cam_fovy[number])) / 2.0)
        x, y, z = (self.root.T @ (data.cam_xpos[number] - self.root_m)).tolist()
        a, b, c, d = to_quaternion(self.root.T @ data.cam_xmat[number].reshape(3, 3) @ OPENCV)
        return Picture(
            camera=name,
            time_s=time_s,
            width=columns,
            height=rows,
            focal_px=(focal / every, focal / every),
            center_px=((sensor.width / 2.0 - left) / every, (sensor.height / 2.0 - top) / every),
            position_m=(x, y, z),
            quaternion_wxyz=(a, b, c, d),
            rgb=np.ascontiguousarray(rgb[some]).tobytes(),
            depth_m=np.ascontiguousarray(depth_m[some], dtype="<f4").tobytes(),
        )

    def _draw(self, data: Any, camera: Any, size: tuple[int, int]) -> tuple[Any, Any]:
        """Colours (h, w, 3) and depths (h, w) [m] of a picture of this height and width."""
        if self._graphics is None:
            most = max(max(sensor.width, sensor.height) for sensor in self.sensors.values())
            self._graphics = _Graphics(self.model, max(most, LOOK_PX))
        return self._graphics.draw(data, camera, size)


def _count_colors(seen: Array) -> list[list[float]]:
    """The most frequent ones of colours (n, 3), each with its share."""
    cells = (seen * (LEVELS - 1e-6)).astype(int)
    _, which, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    kept = np.flatnonzero(counts > LEAST_SHARE * len(seen))
    means = [seen[which.ravel() == number].mean(axis=0).round(3).tolist() for number in kept]
    return [[*mean, round(float(counts[number] / len(seen)), 3)] for number, mean in zip(kept, means, strict=True)]


class _Graphics:
    """Draws one model into a square buffer of `most` pixels a side; colours and depth of a picture come together."""

    def __init__(self, model: Any, most: int) -> None:
        self._model = model
        model.vis.global_.offheight = model.vis.global_.offwidth = most
        model.vis.quality.offsamples = 0  # a pixel shows one surface: a mean of two depths would be that of none
        self._context = mujoco.GLContext(most, most)
        self._context.make_current()
        self._drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        self._drawing.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)
        self._scene, self._options = mujoco.MjvScene(model, GEOMS_MAX), mujoco.MjvOption()
        self._options.geomgroup[:] = [group in VISIBLE_GROUPS for group in range(len(self._options.geomgroup))]
        self._options.sitegroup[:] = 0

    def draw(self, data: Any, camera: Any, size: tuple[int, int]) -> tuple[Any, Any]:
        """Colours (h, w, 3) and depths along the axis (h, w) [m] by a free camera, or by one of the model's names."""
        model, (height, width) = self._model, size
        if isinstance(camera, str):
            camera, name = mujoco.MjvCamera(), camera
            camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(name).id
        self._context.make_current()
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(model, data, self._options, None, camera, everything, self._scene)
        rect = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rect, self._scene, self._drawing)
        rgb, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        mujoco.mjr_readPixels(rgb, depth, rect, self._drawing)
        near_m, far_m = (float(each) * float(model.stat.extent) for each in (model.vis.map.znear, model.vis.map.zfar))
        nearness = 1.0 / far_m + depth.astype(np.float64) * (1.0 / near_m - 1.0 / far_m)  # 1 is near, 0 far
        return rgb[::-1], (1.0 / nearness).astype(np.float32)[::-1]

    def close(self) -> None:
        """Release the graphics."""
        self._context.make_current()
        self._drawing.free()
        self._context.free()
