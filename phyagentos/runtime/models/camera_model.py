"""The geometry of a camera in a compiled model: its lens, its window, and its pose.

OpenCV's convention: z forward, x right, y down; pixel (u, v) has its centre at (u + 1/2, v + 1/2).
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.geometry import compute_rotation
from phyagentos.protocol.settings.sensors import CameraSettings
from phyagentos.runtime.targets.wire import Crop

Array = NDArray[np.float64]
Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]  # (n,) rows and (n,) columns
_MUJOCO_T_OPENCV = np.diag([1.0, -1.0, -1.0])  # MuJoCo looks along -z with y up


@dataclass(frozen=True, slots=True)
class Lens:
    """A pinhole and a window of its picture [pixels]; `cx` and `cy` count from the window's left upper corner."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def crop(self, window: Crop) -> "Lens":
        """The same lens with a window.

        Raises:
            ExecutionError: `REQUEST_INVALID` when the window is empty or leaves the picture.
        """
        left, top, width, height = window
        if min(left, top) < 0 or min(width, height) < 1 or left + width > self.width or top + height > self.height:
            raise ExecutionError(
                "REQUEST_INVALID", f"a window {window} of a picture of {self.width} x {self.height} pixels"
            )
        return replace(self, cx=self.cx - left, cy=self.cy - top, width=width, height=height)

    def thin(self, every: int) -> "Lens":
        """The lens of a picture that has only the middle one of each `every` (odd) rows and columns.

        Raises:
            ExecutionError: `REQUEST_INVALID` when nothing is left, or no row is in the middle.
        """
        width, height = self.width // max(every, 1), self.height // max(every, 1)
        if every < 1 or every % 2 == 0 or min(width, height) < 1:
            raise ExecutionError(
                "REQUEST_INVALID",
                f"every {every} of {self.width} x {self.height} pixels; an odd number that leaves some",
            )
        return Lens(self.fx / every, self.fy / every, self.cx / every, self.cy / every, width, height)

    def compute_rays(self, pixels: Pixels | None = None) -> Array:
        """(n, 3) directions of the pixels' centres in the camera's frame, with z = 1; row by row, or of `pixels`."""
        if pixels is not None:
            rows, columns = pixels
            u, v = (columns + 0.5 - self.cx) / self.fx, (rows + 0.5 - self.cy) / self.fy
            return np.column_stack((u, v, np.ones(len(u))))
        u = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        v = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0], rays[..., 1] = u, v[:, None]
        return rays.reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """Pose of a camera: `world_T_camera`, a position (3,) and a rotation (3, 3)."""

    position_m: Array
    rotation: Array

    def then(self, other: "Viewpoint") -> "Viewpoint":
        """`a_T_b.then(b_T_c)` is `a_T_c`."""
        return Viewpoint(self.position_m + self.rotation @ other.position_m, self.rotation @ other.rotation)


def compute_lens(settings: CameraSettings, scene_fovy_deg: float = 0.0) -> Lens:
    """The lens of the whole picture; `scene_fovy_deg` opens it where the settings give no angle."""
    width, height = settings.width, settings.height
    if settings.fx is not None and settings.fy is not None and settings.cx is not None and settings.cy is not None:
        return Lens(settings.fx, settings.fy, settings.cx, settings.cy, width, height)
    opening = np.radians(settings.fovy_deg if settings.fovy_deg is not None else scene_fovy_deg)
    focal = float(height / 2 / np.tan(opening / 2))
    return Lens(focal, focal, width / 2, height / 2, width, height)


def look_at(position_m: Array, target_m: Array, up: Array) -> Viewpoint:
    """An upright camera that points at a target."""
    forward = target_m - position_m
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    return Viewpoint(position_m, np.column_stack((right, np.cross(forward, right), forward)))


@dataclass(frozen=True, slots=True)
class Mounting:
    """A camera with the lens of its whole picture, as it is fixed to a body of one model; body 0 is the world."""

    lens: Lens
    body: int
    body_T_camera: Viewpoint

    def find(self, data: mujoco.MjData) -> Viewpoint:
        """`world_T_camera` in a state with computed poses."""
        body = Viewpoint(np.array(data.xpos[self.body]), np.array(data.xmat[self.body]).reshape(3, 3))
        return body.then(self.body_T_camera)


def find_mounting(model: mujoco.MjModel, settings: CameraSettings, prefix: str = "") -> Mounting | None:
    """Mounting of a camera in a model; None where the model lacks the body or the scene's camera.

    Bodies and cameras whose names carry the robot's prefix precede those of the scene.
    """
    if settings.scene_camera:
        camera = _find(model, mujoco.mjtObj.mjOBJ_CAMERA, prefix, settings.scene_camera)
        if camera < 0:
            return None
        rotation = compute_rotation(model.cam_quat[camera])
        place = Viewpoint(np.array(model.cam_pos[camera]), rotation @ _MUJOCO_T_OPENCV)
        return Mounting(compute_lens(settings, float(model.cam_fovy[camera])), int(model.cam_bodyid[camera]), place)
    body = _find(model, mujoco.mjtObj.mjOBJ_BODY, prefix, settings.mount)
    if body < 0 or settings.position_m is None or settings.target_m is None:
        return None
    place = look_at(np.array(settings.position_m), np.array(settings.target_m), np.array(settings.up))
    return Mounting(compute_lens(settings), body, place)


def _find(model: mujoco.MjModel, kind: mujoco.mjtObj, prefix: str, name: str) -> int:
    """Id of an element of the robot or, failing that, of the scene; -1 without one."""
    own = mujoco.mj_name2id(model, kind, prefix + name)
    return int(own if own >= 0 else mujoco.mj_name2id(model, kind, name))
