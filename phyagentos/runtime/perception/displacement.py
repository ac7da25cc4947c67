"""Finds displaced cameras: what they measure disagrees with the map, or with the other cameras.

A shift along a plane of the map leaves its points on it; they differ from the other cameras' in the things then.
"""

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from phyagentos.geometry import compute_rotation
from phyagentos.protocol.world.environment import Entity, SensorHealth, Status
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.solids import Array, Solids
from phyagentos.runtime.perception.views import CameraView, Cloud
from phyagentos.runtime.targets.wire import Frame

DISPLACED = "displaced"
KEPT_S = 10.0  # for so long a camera that was displaced is not believed
EVERY = 4  # of so many rows and columns one is read
NEAR_M = 0.08  # farther from the map points are of something else
TILES = 4  # along each side of a picture
TILE_POINTS = 15  # with fewer a tile is not read
REACH_M, POINTS_MIN = 0.05, 40  # of a thing, within which points of its colour are its own; with fewer none is compared
NOISE = 2.5  # median deviations of the points of a tile
OFF_M, TIMES = 0.005, 2.5  # no calibration errs by so much where that of another camera errs so many times less


def find_displaced(
    frames: Sequence[Frame],
    before: Mapping[str, SensorHealth],
    health: Mapping[str, SensorHealth],
    map_solids: Solids,
    time_s: float,
) -> tuple[tuple[Frame, ...], dict[str, SensorHealth]]:
    """The frames of cameras that stand where they say at `time_s`, and the health of all cameras after that `before`.

    One that was displaced is not believed again for `KEPT_S`.
    """
    off_m = {frame.camera: _measure_offset(frame, map_solids) for frame in frames}
    least_m = min(off_m.values(), default=0.0)
    after = dict(health)
    for camera in off_m:
        was = before.get(camera)
        if was is not None and was.status == DISPLACED and time_s - was.since_s < KEPT_S:
            after = note_displaced(after, camera, was.detail, was.since_s)
    for camera, each_m in off_m.items():
        if each_m > max(OFF_M, TIMES * least_m):
            after = note_displaced(after, camera, "its depth disagrees with the map", time_s)
    return tuple(frame for frame in frames if after[frame.camera].status != DISPLACED), after


def find_disagreeing(
    things: Mapping[str, ObjectModel], entities: Mapping[str, Entity], views: Sequence[CameraView], cloud: Cloud
) -> str:
    """The camera whose points of the things lie farthest from where all cameras together see these.

    Empty where none errs by much more than another, or only two are left, of which either may err.
    """
    away_m: list[list[Array]] = [[] for _ in views]
    for name, thing in things.items():
        entity = entities.get(name)
        if entity is None or not thing.template.movable or entity.status is not Status.SEEN:
            continue
        own = cloud.take(cloud.colors == thing.colors[0])
        rotation = compute_rotation(entity.pose.quaternion_wxyz)
        distance = np.abs(thing.solids.measure((own.points_m - entity.pose.position_m) @ rotation))
        for index in range(len(views)):
            away_m[index].append(distance[(own.view_index == index) & (distance < REACH_M)])
    joined = {view.camera: np.concatenate([*each, np.zeros(0)]) for view, each in zip(views, away_m, strict=True)}
    off_m = {camera: float(np.median(each)) for camera, each in joined.items() if len(each) >= POINTS_MIN}
    worst = max(off_m, key=lambda camera: off_m[camera], default="")
    is_odd = len(off_m) > 2 and off_m[worst] > max(OFF_M, TIMES * min(off_m.values()))
    return worst if is_odd else ""


def note_displaced(
    health: Mapping[str, SensorHealth], camera: str, detail: str, since_s: float
) -> dict[str, SensorHealth]:
    """The health of all cameras, of which one is displaced."""
    return {**health, camera: msgspec.structs.replace(health[camera], status=DISPLACED, since_s=since_s, detail=detail)}


def _measure_offset(frame: Frame, map_solids: Solids) -> float:
    """Median, over the tiles of a picture, of the distance between points on the map and its surface [m].

    0 where it is no more than such noisy points may err: a camera that measures coarsely is calibrated coarsely.
    """
    depth = frame.depth_m[::EVERY, ::EVERY]
    rows, columns = np.nonzero(np.isfinite(depth))
    if not len(rows) or not map_solids.kinds:
        return 0.0
    z = depth[rows, columns].astype(np.float64)
    across = (columns * EVERY + 0.5 - frame.cx) / frame.fx * z
    down = (rows * EVERY + 0.5 - frame.cy) / frame.fy * z
    pose = frame.world_T_camera
    points = np.column_stack((across, down, z)) @ compute_rotation(pose.quaternion_wxyz).T + pose.position_m
    away = map_solids.measure(points)
    height, width = depth.shape
    tile = TILES * (TILES * rows // height) + TILES * columns // width
    tile[np.abs(away) > NEAR_M] = -1
    read = [away[tile == k] for k in range(TILES * TILES) if (tile == k).sum() > TILE_POINTS]
    if not read:
        return 0.0
    middles = [_find_median(each) for each in read]
    off_m = _find_median(np.abs(middles))
    noise_m = _find_median(np.array([_find_median(np.abs(each - m)) for each, m in zip(read, middles, strict=True)]))
    return off_m if off_m > NOISE * noise_m else 0.0


def _find_median(values: Array) -> float:
    """Median of finite values (n,); numpy's own checks take three times as long."""
    middle = len(values) // 2
    parts = np.partition(values, (max(middle - 1, 0), middle))
    return float(parts[middle]) if len(values) % 2 else float((parts[middle - 1] + parts[middle]) / 2.0)
