"""From frames to labelled points of the world that belong neither to the map nor to the robot, and what they show.

Surface points of a believed object that face a camera are compared with the measured depth: nearer means hidden, equal
means confirmed, farther means that the camera sees through the believed surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_rotation
from phyagentos.runtime.perception.inventory import THIN_M, Inventory, ObjectModel
from phyagentos.runtime.perception.pose_uncertainty import SIGMA
from phyagentos.runtime.perception.segmentation import is_among
from phyagentos.runtime.perception.solid_distance import project
from phyagentos.runtime.perception.solids import Array, Solids, measure_lengths
from phyagentos.runtime.targets.wire import Frame

MAP_M = THIN_M  # this near to the map and of its colour: part of it
MAP_LIKE_M = 0.007  # this near to the map and of a colour like its own: part of it
RAISED_M, RAISED_STDS = (
    0.0025,
    2.0,
)  # mean height over the map of three by three pixels that are not of it, and in noise
RAISED_MIN = 5  # so many of these pixels have a depth
STEEP = 6.0  # tangent of the greatest slope on which neighbouring pixels surely share a surface
SHARED = 2  # so many of a pixel's eight neighbours do
_UNKNOWN = np.float32(np.inf)
DEPTH_M = 0.010  # depths this close are the same surface
FACING = 0.2  # cosine of the steepest surface that a camera can be expected to see


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraView:
    """One camera at one moment, `world_T_camera`, for visibility queries.

    Attributes:
        focal: (fx, fy, cx, cy) [pixels].
        origin_px: Column and row of the frame's origin in the whole picture.
        nearest_m: (h, w) least depth around each pixel, `farthest_m` the greatest; infinite where nothing was measured.
    """

    camera: str
    time_s: float
    position_m: Array
    rotation: Array
    focal: tuple[float, float, float, float]
    nearest_m: NDArray[np.float32]
    farthest_m: NDArray[np.float32]
    origin_px: tuple[int, int] = (0, 0)


Views = tuple[CameraView, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """Unexplained points of the world, (n, 3), and each one's palette index, camera, and (column, row) in a picture."""

    points_m: Array
    colors: NDArray[np.uint8]
    view_index: NDArray[np.intp]
    pixels: NDArray[np.intp]
    rgb: NDArray[np.uint8]

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> "Cloud":
        """Some of the points."""
        return Cloud(**{name: getattr(self, name)[which] for name in self.__slots__})


def find_cloud(
    frames: Sequence[Frame],
    views: Sequence[CameraView],
    labels: Sequence[NDArray[np.uint8]],
    inventory: Inventory,
    robots: Sequence[Solids],
) -> Cloud:
    """The points in all pictures that are neither the map nor the robot; `labels` (h, w) are of their pixels.

    `robots` are its solids in the world at the time of each frame, grown by model and calibration errors.
    """
    seen = zip(frames, views, labels, robots, strict=True)
    parts = [_find_points(*each, index, inventory) for index, each in enumerate(seen)]
    empty = Cloud(
        points_m=np.zeros((0, 3)),
        colors=np.zeros(0, np.uint8),
        view_index=np.zeros(0, np.intp),
        pixels=np.zeros((0, 2), np.intp),
        rgb=np.zeros((0, 3), np.uint8),
    )
    names = Cloud.__slots__
    return Cloud(**{name: np.concatenate([getattr(part, name) for part in parts or [empty]]) for name in names})


def drop_stray(frame: Frame) -> Frame:
    """The frame without depths that hardly any neighbour shares: noise of surfaces that are seen at a grazing angle."""
    depth, kept = frame.depth_m, np.zeros(frame.depth_m.shape, np.uint8)
    framed = np.pad(depth, 1, constant_values=np.nan)
    limit_m = STEEP / frame.fx * depth
    for row, column in np.ndindex(3, 3):
        neighbour = framed[row : row + frame.height, column : column + frame.width]
        kept += np.abs(neighbour - depth) < limit_m  # itself among them
    return msgspec.structs.replace(frame, depth_m=np.where(kept > SHARED, depth, np.float32(np.nan)))


def make_view(frame: Frame) -> CameraView:
    """One frame, for visibility queries."""
    depth = frame.depth_m
    valid = np.isfinite(depth)
    kernel = np.ones((3, 3), np.uint8)
    near = cv2.erode(np.where(valid, depth, np.float32(1e3)), kernel)
    far = cv2.dilate(np.where(valid, depth, np.float32(-1.0)), kernel)
    return CameraView(
        camera=frame.camera,
        time_s=frame.time_s,
        position_m=np.array(frame.world_T_camera.position_m),
        rotation=compute_rotation(frame.world_T_camera.quaternion_wxyz),
        focal=(frame.fx, frame.fy, frame.cx, frame.cy),
        nearest_m=np.where(valid, near, _UNKNOWN),
        farthest_m=np.where(valid, far, _UNKNOWN),
    )


def _find_points(
    frame: Frame, view: CameraView, labels: NDArray[np.uint8], robot: Solids, index: int, inventory: Inventory
) -> Cloud:
    rows, columns = np.nonzero(np.isfinite(frame.depth_m) & inventory.is_of_object[labels])
    points, colors = measure_points(frame, view, rows, columns), labels[rows, columns]
    keep = ~_find_map(points, colors, inventory) | _find_raised(frame, view, labels, inventory)[rows, columns]
    if len(robot.kinds) and keep.any():
        near = keep & (measure_lengths(points - robot.center_m) < robot.radius_m)
        if near.any():
            keep[near] = robot.near(points[near], 0.0).measure(points[near]) > 0.0
    points, colors, rows, columns = points[keep], colors[keep], rows[keep], columns[keep]
    return Cloud(
        points_m=points,
        colors=colors,
        view_index=np.full(len(points), index, np.intp),
        pixels=np.column_stack((columns, rows)),
        rgb=frame.rgb[rows, columns],
    )


def measure_points(frame: Frame, view: CameraView, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
    """(n, 3) points of the world that these pixels show."""
    depth = frame.depth_m[rows, columns].astype(np.float64)
    fx, fy, cx, cy = view.focal
    rays = np.column_stack(((columns + 0.5 - cx) / fx, (rows + 0.5 - cy) / fy, np.ones(len(rows))))
    points: Array = (rays * depth[:, None]) @ view.rotation.T + view.position_m
    return points


def _find_map(points: Array, colors: NDArray[np.uint8], inventory: Inventory) -> NDArray[np.bool_]:
    """(n,) whether a point is of the map."""
    if not inventory.map.kinds:
        return np.zeros(len(points), np.bool_)
    found = np.zeros(len(points), np.bool_)
    for lookalikes, margin in ((inventory.map_colors, MAP_M), (inventory.like_map, MAP_LIKE_M)):
        among = is_among(colors, lookalikes)
        found[among] = inventory.map.measure(points[among]) < margin
    return found


def _find_raised(frame: Frame, view: CameraView, labels: NDArray[np.uint8], inventory: Inventory) -> NDArray[np.bool_]:
    """(h, w) which pixels in a thin object's colour, like the map's, are of a plateau: noise averages out, a board not.

    Heights over the map count from the plane that this camera, calibrated somewhat wrong, sees the map in.
    """
    if not inventory.map.kinds or not inventory.thin:
        return np.zeros(labels.shape, np.bool_)
    alike = is_among(labels, inventory.map_colors | inventory.like_map)
    rows, columns = np.nonzero(np.isfinite(frame.depth_m) & alike)
    points = measure_points(frame, view, rows, columns)
    away_m, design = inventory.map.measure(points), np.column_stack((np.ones(len(points)), points[:, :2]))
    near = np.abs(away_m) < MAP_M
    away_m -= design @ np.linalg.lstsq(design[near], away_m[near], rcond=None)[0]
    noise_m = SIGMA * float(np.median(np.abs(away_m[near]))) if near.any() else 0.0
    height_m, count = np.zeros((2, *labels.shape), np.float32)
    height_m[rows, columns], count[rows, columns] = np.clip(away_m, -MAP_LIKE_M, MAP_LIKE_M), 1.0
    height_m, count = (cv2.boxFilter(each, -1, (3, 3), normalize=False) for each in (height_m, count))
    least_m = np.maximum(count * RAISED_M, RAISED_STDS * noise_m * np.sqrt(count))
    raised: NDArray[np.bool_] = (count >= RAISED_MIN) & (height_m > least_m) & is_among(labels, inventory.thin)
    return raised


@dataclass(frozen=True, slots=True)
class Visibility:
    """Points of an object's surface over all cameras, measured at the expected depth, nearer, or farther."""

    confirmed: int
    hidden: int
    contradicted: int

    @property
    def contradicted_fraction(self) -> float:
        """Of the points that are not hidden."""
        return self.contradicted / max(self.confirmed + self.contradicted, 1)


def compute_visibility(item: ObjectModel, rotation: Array, position_m: Array, views: Views) -> Visibility:
    """Visibility of an object in a pose."""
    return measure_visibility(item.samples_m, item.normals, rotation, position_m, views)


def measure_visibility(
    samples_m: Array, normals: Array, rotation: Array, position_m: Array, views: Views
) -> Visibility:
    """Visibility of a posed surface, of which points (n, 3) and normals are in its own frame."""
    pose = np.ascontiguousarray(rotation), np.ascontiguousarray(position_m)  # other layouts would be compiled for, too
    confirmed = hidden = contradicted = 0
    for view in views:
        v, u, depth, _ = project(
            samples_m, normals, pose, (view.rotation, view.position_m), view.focal, view.nearest_m.shape, FACING
        )
        near, far = view.nearest_m[v, u], view.farthest_m[v, u]
        measured = np.isfinite(near)
        through = measured & (near > depth + DEPTH_M)
        before = measured & (far < depth - DEPTH_M)
        contradicted += int(through.sum())
        hidden += int(before.sum())
        confirmed += int((measured & ~through & ~before).sum())
    return Visibility(confirmed, hidden, contradicted)
