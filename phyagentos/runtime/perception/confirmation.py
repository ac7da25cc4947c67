"""Whether a glance shows the belief: a thing that did not move is confirmed without another fit.

Two tests: the surface that faces the camera has its colour and its depth; and one step of the fit (`fitting`) leaves
the pose unchanged.
"""

import numpy as np
from numpy.typing import NDArray

from phyagentos.geometry import compute_rotation, compute_rotation_vector
from phyagentos.protocol.sessions.looks import format_pointer
from phyagentos.protocol.world.environment import Entity, Status
from phyagentos.runtime.perception.doubt import FREE
from phyagentos.runtime.perception.fitting import Patch, refine
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.segmentation import is_among
from phyagentos.runtime.perception.solid_distance import project
from phyagentos.runtime.perception.solids import Array
from phyagentos.runtime.perception.views import DEPTH_M, FACING
from phyagentos.runtime.targets.wire import Frame

LOOKS_MIN = 2  # a pose from one look alone is worth another fit
LEAST_PIXELS = 12  # of its colour, on its surface
SHOWN = 0.6  # of its surface that faces the camera: seen in its colour, at its depth
MEASURED = 0.2  # of that surface: so much of it has a depth at least
NEAR_M = 0.010  # of the believed surface
OWN = 0.8  # of the pixels of its colour in the window: this near
SHIFT_M, TURN_RAD = 0.003, 0.06  # one step of a fit that is less than this is noise


def is_settled(entity: Entity | None, thing: ObjectModel | None) -> bool:
    """Whether a thing is believed to stand still, in a pose that more than one look has measured."""
    return (
        entity is not None
        and thing is not None
        and thing.vessel is None
        and entity.status is Status.SEEN
        and entity.looks >= LOOKS_MIN
        and not entity.speed_m_s
    )


def confirm(
    thing: ObjectModel,
    entity: Entity,
    frame: Frame,
    labels: NDArray[np.uint8],
    focal_px: tuple[float, float, float, float],
) -> str | None:
    """Pointer to the thing where a picture confirms its believed pose; None in doubt.

    The frame is a window, thinned or not; `labels` are (h, w) palette indices; `focal_px` is of the whole picture.
    """
    rotation, position = compute_rotation(entity.pose.quaternion_wxyz), np.array(entity.pose.position_m)
    camera_m = np.array(frame.world_T_camera.position_m)
    view = compute_rotation(frame.world_T_camera.quaternion_wxyz)
    if _measure_shown(thing, (rotation, position), frame, labels, (view, camera_m)) < SHOWN:
        return None
    rows, columns = np.nonzero(np.isfinite(frame.depth_m) & (labels == thing.colors[0]))
    depth = frame.depth_m[rows, columns].astype(np.float64)
    rays = ((columns + 0.5 - frame.cx) / frame.fx * depth, (rows + 0.5 - frame.cy) / frame.fy * depth, depth)
    points = np.column_stack(rays) @ view.T + camera_m
    near = np.abs(thing.solids.measure((points - position) @ rotation)) < NEAR_M
    if near.sum() < LEAST_PIXELS or near.mean() < OWN:
        return None
    turned, moved = refine(thing.solids, Patch.from_eyes(points[near], camera_m), rotation, position, FREE, 1)
    shown = thing.turns.T @ compute_rotation_vector(rotation.T @ turned)
    if np.linalg.norm(moved - position) > SHIFT_M or np.linalg.norm(shown) > TURN_RAD:
        return None
    return _point_at(frame, rows[near], columns[near], focal_px)


def _measure_shown(
    thing: ObjectModel, pose: tuple[Array, Array], frame: Frame, labels: NDArray[np.uint8], view: tuple[Array, Array]
) -> float:
    """Share of the surface facing the camera that is seen as expected; 0 where too little of it was measured.

    What has its colour but no depth, as many a pixel of glass, counts as what has its colour and a depth does.
    """
    focal, size = (frame.fx, frame.fy, frame.cx, frame.cy), frame.depth_m.shape
    rows, columns, z, facing = project(thing.samples_m, thing.normals, pose, view, focal, size, FACING)
    depth, own = frame.depth_m[rows, columns], is_among(labels[rows, columns], thing.colors)
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
    return format_pointer(frame.camera, frame.time_s, (left + every * u, top + every * v, width, height))
