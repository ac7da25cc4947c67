"""Windows of pictures that show a thing: a hold condition costs a glance instead of a whole look."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from phyagentos.geometry import compute_rotation
from phyagentos.protocol.world.environment import Entity, SensorHealth
from phyagentos.runtime.perception.inventory import Inventory
from phyagentos.runtime.perception.solids import Array
from phyagentos.runtime.targets.wire import Crop

MARGIN = 1.35  # of the ball around a thing: it may have moved a little, and what is beside it shows edges


@dataclass(frozen=True, slots=True, kw_only=True)
class Extrinsics:
    """Pose of a camera, and its whole picture."""

    position_m: Array
    rotation: Array
    focal: tuple[float, float, float, float]
    width: int
    height: int

    @classmethod
    def find(cls, camera: SensorHealth) -> "Extrinsics | None":
        """Of the latest whole frame; None without one."""
        if camera.pose is None:
            return None
        return cls(
            position_m=np.array(camera.pose.position_m),
            rotation=compute_rotation(camera.pose.quaternion_wxyz),
            focal=camera.focal_px,
            width=camera.size_px[0],
            height=camera.size_px[1],
        )


def find_regions_of_interest(
    names: Iterable[str],
    entities: Mapping[str, Entity],
    inventory: Inventory,
    cameras: Mapping[str, Extrinsics],
    most: int,
) -> dict[str, Crop]:
    """One region around all these things in each of the `most` cameras per thing that saw them best."""
    boxes: dict[str, list[tuple[float, float, float, float]]] = {}
    for name in names:
        entity, thing = entities.get(name), inventory.things.get(name)
        if entity is None or thing is None:
            continue
        for camera in _rank(entity, cameras)[:most]:
            box = _project(entity, thing.diameter_m / 2 * MARGIN, thing.solids.center_m, cameras[camera])
            if box is not None:
                boxes.setdefault(camera, []).append(box)
    regions = {camera: _bound(found, cameras[camera]) for camera, found in boxes.items()}
    return {camera: region for camera, region in regions.items() if region is not None}


def _rank(entity: Entity, cameras: Mapping[str, Extrinsics]) -> list[str]:
    """Cameras by the thing's area in their latest pictures, largest first."""
    areas = dict.fromkeys(cameras, 0)
    for pointer in entity.evidence:
        camera, _, rest = pointer.partition("@")
        if camera in areas:
            _, _, width, height = (int(part) for part in rest.partition(":")[2].split(","))
            areas[camera] = width * height
    return sorted(areas, key=lambda camera: (-areas[camera], camera))


def _project(
    entity: Entity, radius_m: float, center: Array, camera: Extrinsics
) -> tuple[float, float, float, float] | None:
    middle = compute_rotation(entity.pose.quaternion_wxyz) @ center + np.array(entity.pose.position_m)
    x, y, z = (camera.rotation.T @ (middle - camera.position_m)).tolist()
    if z < 2 * radius_m:
        return None
    fx, fy, cx, cy = camera.focal
    u, v = x / z * fx + cx, y / z * fy + cy
    return u - radius_m / z * fx, v - radius_m / z * fy, u + radius_m / z * fx, v + radius_m / z * fy


def _bound(boxes: list[tuple[float, float, float, float]], camera: Extrinsics) -> Crop | None:
    left, top = max(0, int(min(box[0] for box in boxes))), max(0, int(min(box[1] for box in boxes)))
    right = min(camera.width, int(max(box[2] for box in boxes)) + 2)
    bottom = min(camera.height, int(max(box[3] for box in boxes)) + 2)
    return (left, top, right - left, bottom - top) if right - left > 2 and bottom - top > 2 else None
