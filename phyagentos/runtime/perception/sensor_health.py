"""Health of a camera: its frames arrive, advance in time, do not repeat the same picture, and agree with the map.

The noise of a real sensor never repeats: two pictures that are equal bit for bit are one. Between whole pictures a
small window of each camera is probed now and then, which detects a frozen camera before the next look. A sensor without
declared noise may show a still scene twice; it is frozen where its picture stays although the robot has moved through
what it shows, or has carried the camera along. While the robot stands still, no picture proves anything: until its
first change a camera without a count is unproven, and no verdict rests on such cameras alone. A sensor that counts its
exposures is frozen where its stamps advance and its count does not.

A displaced camera disagrees with the map, or with the other cameras: a shift along a plane of the map leaves its points
on it, and they differ from the other cameras' in the objects then.
"""

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np

from phyagentos.geometry import compute_rotation, compute_rotation_vector
from phyagentos.protocol.world.environment import UNPROVEN, Entity, Pose, SensorHealth, Status, TargetState
from phyagentos.runtime.perception.forms import sample_surface
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.perception.solid_distance import project
from phyagentos.runtime.perception.solids import Array, Solids
from phyagentos.runtime.perception.views import DEPTH_M, FACING, CameraView, Cloud, make_view
from phyagentos.runtime.targets.wire import Crop, Frame, Frames

Proof = Callable[[Frame, SensorHealth], bool]
"""Whether a live camera would now show another picture than the one that this health remembers."""

SAME_S = 1e-6  # stamps this near to each other are one
AHEAD_S = 0.005  # no frame is from the future
PROBE_PX = 12  # side of the window in the middle of a picture: a few hundred numbers with noise never repeat
REPEATED = "a new stamp on the same picture"
UNCOUNTED = "a new stamp, and its own count of exposures stands"
DISPLACED = "displaced"
KEPT_S = 10.0  # for so long a camera that was displaced is not believed
EVERY = 4  # of so many rows and columns one is read
NEAR_M = 0.08  # farther from the map points are of something else
TILES = 4  # along each side of a picture
TILE_POINTS = 15  # with fewer a tile is not read
NOISE = 2.5  # median deviations of the points of a tile
SAMPLES = 8  # so many more points of the robot that are absent than when the picture was new
REACH_M, POINTS_MIN = 0.05, 40  # of an object, within which points of its colour are its own; fewer are not compared
OFF_M, TIMES = 0.005, 2.5  # no calibration errs by so much where that of another camera errs so many times less
CARRIED_M, CARRIED_RAD = 0.002, 0.002  # by which the camera itself was moved


def assess(
    frames: Frames,
    before: Mapping[str, SensorHealth],
    now_s: float,
    max_age_s: float,
    would_differ: Proof = lambda _frame, _was: True,
    joints_rad: Callable[[float], tuple[float, ...]] = lambda _time_s: (),
) -> tuple[tuple[Frame, ...], dict[str, SensorHealth]]:
    """The frames of healthy cameras, at most `max_age_s` old, and the health of every camera.

    The robot's `joints_rad` at the time of a picture are remembered with it.
    """
    health = dict(before)
    believed: list[Frame] = []
    for camera, code in frames.missing.items():
        health[camera] = _turn(before.get(camera), "missing", now_s, code)
    for frame in frames.frames:
        was, digest = before.get(frame.camera), compute_digest(frame)
        status, detail = _judge(frame, digest, was, now_s, max_age_s, would_differ)
        is_same = was is None or (was.status == UNPROVEN and was.digest == digest)
        if status == "live" and is_same and frame.number < 0 and joints_rad(frame.time_s):
            status = UNPROVEN
        turned = _turn(was, status, now_s, detail)
        repeats = was is not None and was.digest == digest
        health[frame.camera] = msgspec.structs.replace(
            turned,
            time_s=frame.time_s,
            number=frame.number,
            digest=digest,
            shown_rad=turned.shown_rad if repeats else joints_rad(frame.time_s),
            pose=turned.pose if repeats else frame.world_T_camera,
            focal_px=(frame.fx, frame.fy, frame.cx, frame.cy),
            size_px=(frame.width, frame.height),
        )
        if status in {"live", UNPROVEN}:
            believed.append(frame)
    return tuple(believed), health


def find_probe_regions(health: Mapping[str, SensorHealth]) -> dict[str, Crop]:
    """The probe windows: the middle of every picture whose size is known."""
    return {
        camera: (each.size_px[0] // 2 - PROBE_PX // 2, each.size_px[1] // 2 - PROBE_PX // 2, PROBE_PX, PROBE_PX)
        for camera, each in health.items()
        if min(each.size_px) >= PROBE_PX
    }


class Probe(NamedTuple):
    """A small window of a camera's frame: the hash of its pixels, and the stamp of the frame [s]."""

    digest: str
    time_s: float

    def __str__(self) -> str:
        """`hash@time`."""
        return f"{self.digest}@{self.time_s:.6f}"

    @classmethod
    def parse(cls, text: str) -> "Probe":
        """The probe of a text; of an empty one, none that was ever taken."""
        digest, _, stamp = text.partition("@")
        return cls(digest, float(stamp) if stamp else -math.inf)


def check_probes(frames: Frames, before: Mapping[str, SensorHealth], now_s: float) -> dict[str, SensorHealth]:
    """Health of the cameras by these windows: one that repeats with a new stamp is of a frozen camera."""
    health = {camera: msgspec.structs.replace(each, probed_s=now_s) for camera, each in before.items()}
    for frame in frames.frames:
        was = health.get(frame.camera)
        if was is None:
            continue  # not asked for
        if not np.isfinite(frame.depth_m).any():
            health[frame.camera] = msgspec.structs.replace(was, liveness_probe="")  # darkness repeats
            continue
        before_it = Probe.parse(was.liveness_probe)
        if frame.time_s <= before_it.time_s + SAME_S:
            continue  # the same frame once more: the next ones were lost
        probe = Probe(compute_digest(frame), frame.time_s)
        if probe.digest == before_it.digest:
            was = _turn(was, "frozen", now_s, REPEATED)
        elif was.status == "frozen":
            was = _turn(was, "live", now_s, "")
        health[frame.camera] = msgspec.structs.replace(was, liveness_probe=str(probe))
    return health


def compute_digest(frame: Frame) -> str:
    """Hash of a picture."""
    digest = hashlib.blake2b(frame.rgb.tobytes(), digest_size=12)
    digest.update(frame.depth_m.tobytes())
    return digest.hexdigest()


def _judge(
    frame: Frame, digest: str, was: SensorHealth | None, now_s: float, max_age_s: float, would_differ: Proof
) -> tuple[str, str]:
    age_s = now_s - frame.time_s
    if not age_s <= max_age_s:  # also when its stamp is no number
        return "stale", f"its latest frame is {age_s:.2f} s old"
    if age_s < -AHEAD_S:
        return "stale", f"its frame is dated {-age_s:.2f} s ahead"
    if not np.isfinite(frame.depth_m).any():
        return "dark", "no depth at all"
    if was is None:
        return "live", ""
    is_uncounted = was.detail == UNCOUNTED
    if 0 <= frame.number == was.number and (is_uncounted or frame.time_s > was.time_s + SAME_S):
        return "frozen", UNCOUNTED
    if was.status == "frozen" and not is_uncounted and (was.liveness_probe or was.digest == digest):
        return "frozen", REPEATED
    if was.digest == digest and frame.time_s > was.time_s + SAME_S and would_differ(frame, was):
        return "frozen", REPEATED
    return "live", ""


def _turn(was: SensorHealth | None, status: str, now_s: float, detail: str) -> SensorHealth:
    """A camera that enters a status, or is still in it."""
    return msgspec.structs.replace(
        was or SensorHealth(),
        status=status,
        since_s=was.since_s if was is not None and was.status == status else now_s,
        detail=detail,
    )


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
    objects: Mapping[str, ObjectModel], entities: Mapping[str, Entity], views: Sequence[CameraView], cloud: Cloud
) -> str:
    """The camera whose points of the objects lie farthest from where all cameras together see these.

    Empty where none errs by much more than another, or only two are left, of which either may err.
    """
    away_m: list[list[Array]] = [[] for _ in views]
    for name, item in objects.items():
        entity = entities.get(name)
        if entity is None or not item.template.movable or entity.status is not Status.SEEN:
            continue
        own = cloud.take(cloud.colors == item.colors[0])
        rotation = compute_rotation(entity.pose.quaternion_wxyz)
        distance = np.abs(item.solids.measure((own.points_m - entity.pose.position_m) @ rotation))
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


def has_moved_in_view(frame: Frame, was: SensorHealth, robot: RobotMask, state: TargetState) -> bool:
    """Whether a picture equal to an earlier one should differ from it; `state` is the robot's at its stamp."""
    if was.pose is None or not was.shown_rad:
        return False
    if _is_carried(was.pose, frame.world_T_camera):
        return True
    view = make_view(frame)
    then = msgspec.structs.replace(state, q_rad=was.shown_rad)
    return _count_absent(view, robot, state) > _count_absent(view, robot, then) + SAMPLES


def _is_carried(was: Pose, pose: Pose) -> bool:
    moved_m = float(np.linalg.norm(np.subtract(pose.position_m, was.position_m)))
    turned = compute_rotation(pose.quaternion_wxyz) @ compute_rotation(was.quaternion_wxyz).T
    return moved_m > CARRIED_M or float(np.linalg.norm(compute_rotation_vector(turned))) > CARRIED_RAD


def _count_absent(view: CameraView, robot: RobotMask, state: TargetState) -> int:
    """Points of the robot's surface that face the camera, and where it measures something behind them, or nothing."""
    posed = robot.pose(state)
    samples, normals = sample_surface(replace(posed, inflate_m=np.zeros_like(posed.inflate_m)))
    here, camera = (np.eye(3), np.zeros(3)), (view.rotation, view.position_m)
    v, u, depth, _ = project(samples, normals, here, camera, view.focal, view.nearest_m.shape, FACING)
    return int((view.nearest_m[v, u] > depth + DEPTH_M).sum())
