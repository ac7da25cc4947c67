"""Whether a short look confirms the belief, and where: an object that did not move is confirmed without another fit.

Two tests: the surface that faces the camera has its colour and its depth; and one step of the fit (`fitting`) leaves
the pose unchanged.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_rotation, compute_rotation_vector
from phyagentos.protocol.sessions.looks import Pointer
from phyagentos.protocol.world.environment import Entity, SensorHealth, Status
from phyagentos.runtime.perception.fitting import Patch, refine
from phyagentos.runtime.perception.inventory import Inventory, ObjectModel
from phyagentos.runtime.perception.pose_uncertainty import FREE
from phyagentos.runtime.perception.segmentation import is_among
from phyagentos.runtime.perception.solid_distance import project
from phyagentos.runtime.perception.solids import Array
from phyagentos.runtime.perception.views import DEPTH_M, FACING
from phyagentos.runtime.targets.wire import Crop, Frame

LOOKS_MIN = 2  # a pose from one look alone is worth another fit
LEAST_PIXELS = 12  # of its colour, on its surface
SHOWN = 0.6  # of its surface that faces the camera: seen in its colour, at its depth
MEASURED = 0.2  # of that surface: so much of it has a depth at least
NEAR_M = 0.010  # of the believed surface
OWN = 0.8  # of the pixels of its colour in the window: this near
SHIFT_M, TURN_RAD = 0.003, 0.06  # one step of a fit that is less than this is noise
MARGIN = 1.35  # of the ball around an object: it may have moved a little, and what is beside it shows edges


def is_settled(entity: Entity | None, item: ObjectModel | None) -> bool:
    """Whether an object is believed to stand still, in a pose that more than one look has measured."""
    return (
        entity is not None
        and item is not None
        and item.vessel is None
        and entity.status is Status.SEEN
        and entity.looks >= LOOKS_MIN
        and not entity.speed_m_s
    )


def confirm(
    item: ObjectModel,
    entity: Entity,
    frame: Frame,
    labels: NDArray[np.uint8],
    focal_px: tuple[float, float, float, float],
) -> str | None:
    """Pointer to the object where a picture confirms its believed pose; None where uncertain.

    The frame is a window, thinned or not; `labels` are (h, w) palette indices; `focal_px` is of the whole picture.
    """
    rotation, position = compute_rotation(entity.pose.quaternion_wxyz), np.array(entity.pose.position_m)
    camera_m = np.array(frame.world_T_camera.position_m)
    view = compute_rotation(frame.world_T_camera.quaternion_wxyz)
    if _measure_shown(item, (rotation, position), frame, labels, (view, camera_m)) < SHOWN:
        return None
    rows, columns = np.nonzero(np.isfinite(frame.depth_m) & (labels == item.colors[0]))
    depth = frame.depth_m[rows, columns].astype(np.float64)
    rays = ((columns + 0.5 - frame.cx) / frame.fx * depth, (rows + 0.5 - frame.cy) / frame.fy * depth, depth)
    points = np.column_stack(rays) @ view.T + camera_m
    near = np.abs(item.solids.measure((points - position) @ rotation)) < NEAR_M
    if near.sum() < LEAST_PIXELS or near.mean() < OWN:
        return None
    turned, moved = refine(item.solids, Patch.from_eyes(points[near], camera_m), rotation, position, FREE, 1)
    shown = item.turns.T @ compute_rotation_vector(rotation.T @ turned)
    if np.linalg.norm(moved - position) > SHIFT_M or np.linalg.norm(shown) > TURN_RAD:
        return None
    return _point_at(frame, rows[near], columns[near], focal_px)


def _measure_shown(
    item: ObjectModel, pose: tuple[Array, Array], frame: Frame, labels: NDArray[np.uint8], view: tuple[Array, Array]
) -> float:
    """Share of the surface facing the camera that is seen as expected; 0 where too little of it was measured.

    What has its colour but no depth, as many a pixel of glass, counts as what has its colour and a depth does.
    """
    focal, size = (frame.fx, frame.fy, frame.cx, frame.cy), frame.depth_m.shape
    rows, columns, z, facing = project(item.samples_m, item.normals, pose, view, focal, size, FACING)
    depth, own = frame.depth_m[rows, columns], is_among(labels[rows, columns], item.colors)
    expected, measured = np.count_nonzero(own & (np.abs(depth - z) < DEPTH_M)), np.count_nonzero(own & (depth > 0.0))
    if expected < MEASURED * max(facing, 1):
        return 0.0
    return float(np.count_nonzero(own) / facing * expected / measured)


def _point_at(
    frame: Frame, rows: NDArray[np.intp], columns: NDArray[np.intp], focal_px: tuple[float, float, float, float]
) -> str:
    """Pointer to these pixels, in the whole picture."""
    fx, _, cx, cy = focal_px
    every = round(fx / frame.fx)
    left, top = round(cx - frame.cx * every), round(cy - frame.cy * every)
    u, v = int(columns.min()), int(rows.min())
    width, height = every * (int(columns.max()) - u + 1), every * (int(rows.max()) - v + 1)
    return str(Pointer(frame.camera, frame.time_s, (left + every * u, top + every * v, width, height)))


def find_regions_of_interest(
    names: Iterable[str],
    entities: Mapping[str, Entity],
    inventory: Inventory,
    cameras: Mapping[str, SensorHealth],
    most: int,
) -> dict[str, Crop]:
    """One region around all these objects in each of the `most` cameras per object that saw them best."""
    boxes: dict[str, list[tuple[float, float, float, float]]] = {}
    for name in names:
        entity, item = entities.get(name), inventory.objects.get(name)
        if entity is None or item is None:
            continue
        for camera in _rank(entity, cameras)[:most]:
            box = _project(entity, item.diameter_m / 2 * MARGIN, item.solids.center_m, cameras[camera])
            if box is not None:
                boxes.setdefault(camera, []).append(box)
    regions = {camera: _bound(found, cameras[camera]) for camera, found in boxes.items()}
    return {camera: region for camera, region in regions.items() if region is not None}


def _rank(entity: Entity, cameras: Mapping[str, SensorHealth]) -> list[str]:
    """Cameras by the object's area in their latest pictures, largest first."""
    areas = dict.fromkeys(cameras, 0)
    areas |= {each.camera: each.area_px for each in Pointer.parse_all(entity.evidence) if each.camera in areas}
    return sorted(areas, key=lambda camera: (-areas[camera], camera))


def _project(
    entity: Entity, radius_m: float, center: Array, camera: SensorHealth
) -> tuple[float, float, float, float] | None:
    if camera.pose is None:
        return None
    middle = compute_rotation(entity.pose.quaternion_wxyz) @ center + np.array(entity.pose.position_m)
    rotation = compute_rotation(camera.pose.quaternion_wxyz)
    x, y, z = (rotation.T @ (middle - np.array(camera.pose.position_m))).tolist()
    if z < 2 * radius_m:
        return None
    fx, fy, cx, cy = camera.focal_px
    u, v = x / z * fx + cx, y / z * fy + cy
    return u - radius_m / z * fx, v - radius_m / z * fy, u + radius_m / z * fx, v + radius_m / z * fy


def _bound(boxes: list[tuple[float, float, float, float]], camera: SensorHealth) -> Crop | None:
    left, top = max(0, int(min(box[0] for box in boxes))), max(0, int(min(box[1] for box in boxes)))
    right = min(camera.size_px[0], int(max(box[2] for box in boxes)) + 2)
    bottom = min(camera.size_px[1], int(max(box[3] for box in boxes)) + 2)
    return (left, top, right - left, bottom - top) if right - left > 2 and bottom - top > 2 else None
