"""A picture of arrays: colours and depth of one moment become what the wire has, whole or a window of it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from target_server.body import Picture, Window
from target_server.kinematics import Array, to_quaternion
from target_server.wire import Refusal


@dataclass(frozen=True)
class Exposure:
    """Colours (h, w, 3), and depth (h, w) registered to them in units of `unit_m` [m], at a moment of the body [s].

    The lens counts from the corner of the first pixel.
    """

    camera: str
    time_s: float
    rgb: NDArray[np.uint8]
    depth: NDArray[Any]
    unit_m: float
    focal_px: tuple[float, float]
    center_px: tuple[float, float]

    def develop(self, pose: Array, window: "Window | None", every: int) -> Picture:
        """The picture, or a part of it, from `world_T_camera` (4, 4); raises `Refusal` for a window outside of it."""
        height, width = self.depth.shape
        left, top, wide, high = window or (0, 0, width, height)
        rows, columns = high // max(every, 1), wide // max(every, 1)
        is_inside = min(left, top) >= 0 and left + wide <= width and top + high <= height
        if not is_inside or every < 1 or every % 2 == 0 or min(rows, columns) < 1:
            raise Refusal("REQUEST_INVALID", f"every {every} of a window {window} of a picture of {width} x {height}")
        some = np.ix_(top + every // 2 + every * np.arange(rows), left + every // 2 + every * np.arange(columns))
        depth_m = self.depth[some].astype("<f4") * np.float32(self.unit_m)
        depth_m[~(depth_m > 0.0) | np.isinf(depth_m)] = np.nan
        (fx, fy), (cx, cy), (x, y, z) = self.focal_px, self.center_px, pose[:3, 3].tolist()
        return Picture(
            camera=self.camera, time_s=self.time_s, width=columns, height=rows,
            focal_px=(fx / every, fy / every), center_px=((cx - left) / every, (cy - top) / every),
            position_m=(x, y, z), quaternion_wxyz=to_quaternion(pose[:3, :3]),
            rgb=np.ascontiguousarray(self.rgb[some]).tobytes(), depth_m=depth_m.tobytes(),
        )  # fmt: skip
