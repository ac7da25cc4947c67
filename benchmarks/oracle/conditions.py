"""Conditions of suites beside those of the scorer `simulator`: from a recorded simulator state, MuJoCo and numpy alone.

A suite names one as `benchmarks.oracle.conditions:is_borne`; each gets the folder of an evidence bundle first.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
import yaml

from benchmarks.oracle.moment import Moment
from benchmarks.oracle.predicates import Judge

ROBOTS = Path(__file__).resolve().parents[2] / "robots"
REST_M_S = 0.05
GAP_M = 0.006  # between what rests on each other, contact softness and a small tilt included
LEVEL_COS = 0.985  # ten degrees
FLOOR_SLACK_M = 0.004
POSED_RAD, POSED_S, REST_RAD_S = 0.05, 0.9, 0.05  # of a posture: how near, how long before the end, how still
BASE_JOINTS = ["base_x", "base_y", "base_yaw"]


def is_borne(folder: Path, load: str, carrier: str, half_m: Sequence[float], height_m: float) -> bool:
    """Whether the middle of `load` stands `height_m` [m] above that of a level box of these half extents (2,) [m]."""
    end = Moment.read(folder)
    place = end.find_local(load, carrier)
    is_over = abs(place[0]) <= half_m[0] and abs(place[1]) <= half_m[1]
    return bool(end.locate(carrier)[0][2, 2] > LEVEL_COS and is_over and abs(place[2] - height_m) <= GAP_M)


def is_in_place(folder: Path, thing: str, place: str, center_m: Sequence[float], half_m: Sequence[float]) -> bool:
    """Whether the box of a free body lies at rest in the interior of a place, on its floor.

    Args:
        folder: An evidence bundle.
        thing: Body name of a free body whose first geometry is a box.
        place: Body name of a body with an interior.
        center_m: (3,) middle of the interior in the frame of the place [m].
        half_m: (3,) half extents of the interior [m].
    """
    end, half = Moment.read(folder), np.array(half_m)
    (turn, at), geom = end.locate(place), end.model.body(thing).geomadr[0]
    corners = np.array(np.meshgrid(*([-1, 1],) * 3)).reshape(3, 8) * end.model.geom_size[geom][:, None]
    world = end.data.geom_xpos[geom][:, None] + end.data.geom_xmat[geom].reshape(3, 3) @ corners
    local = turn.T @ (world - at[:, None]) - np.array(center_m)[:, None]
    within = np.all(np.abs(local[:2].mean(axis=1)) < half[:2])
    within &= -half[2] - FLOOR_SLACK_M < local[2].min() < half[2]
    return bool(within) and _is_at_rest(end, thing)


def is_posed(
    folder: Path, posture_rad: Mapping[str, float], held_s: float = POSED_S, still_rad_s: float = REST_RAD_S
) -> bool:
    """Whether every joint is at its place [rad] and at rest at the end, and was measured there for some time before.

    Args:
        folder: An evidence bundle.
        posture_rad: By name of a joint, in the order of the recorded trajectory.
        held_s: That time [s].
        still_rad_s: How fast a joint at rest may be; one that is pushed sways [rad/s].
    """
    if not (folder / "trajectory.npz").exists():
        return False  # its worker was lost: nothing was measured
    end, wanted = Moment.read(folder), np.array(list(posture_rad.values()))
    joints = [end.model.joint(name) for name in posture_rad]
    q, qd = end.data.qpos[[int(j.qposadr[0]) for j in joints]], end.data.qvel[[int(j.dofadr[0]) for j in joints]]
    with np.load(folder / "trajectory.npz") as course:
        late = course["time_s"] >= course["time_s"][-1] - held_s
        rows = np.vstack((course["q_measured"][late][:, -len(q) :], q))  # the pose of a base comes first
    return bool((np.abs(rows - wanted) <= POSED_RAD).all() and (np.abs(qd) <= still_rad_s).all())


def is_standing(folder: Path, body: str, least_m: float, place: str = "", ahead_m: float = 0.0) -> bool:
    """Whether a body is level within 10 degrees and at least so high at the end, at rest on feet that touch the floor.

    With a `place` it also faces that body within 6 degrees, its origin within 7 cm of `ahead_m` from its centre.
    """
    end = Moment.read(folder)
    R, at = end.locate(body)
    roots = {int(end.model.body_rootid[each]) for each in end.find_touching("floor")}
    stands = R[2, 2] > np.cos(np.radians(10)) and at[2] >= least_m and end.find(body) in roots
    stands &= _is_at_rest(end, body)
    if not place:
        return bool(stands)
    to_place = (end.locate(place)[1] - at)[:2]
    turned = np.arctan2(*(R[1::-1, 0])) - np.arctan2(to_place[1], to_place[0])
    faces = abs(np.remainder(turned + np.pi, 2 * np.pi) - np.pi) < np.radians(6)
    return bool(stands and faces and abs(np.linalg.norm(to_place) - ahead_m) < 0.07)


def is_parked(folder: Path, body: str, mount_wxyz: Sequence[float], place: str, at_m: Sequence[float]) -> bool:
    """Whether a base is at rest within 5 cm and 6 degrees of a point (3,) of a body's frame, headed as that frame is.

    `mount_wxyz` is how the base's own frame stands in the world where it is headed along x.
    """
    end, mount = Moment.read(folder), np.zeros(9)
    mujoco.mju_quat2Mat(mount, np.array(mount_wxyz, dtype=float))
    turned = end.locate(place)[0].T @ end.locate(body)[0] @ mount.reshape(3, 3).T
    is_there = np.linalg.norm((end.find_local(body, place) - at_m)[:2]) < 0.05 and turned[0, 0] > np.cos(np.radians(6))
    return bool(is_there) and _is_at_rest(end, body)


def is_held_up(folder: Path, thing: str, supports: Sequence[str]) -> bool:
    """Whether a free body is at rest, on none of its supports, and touched by two fingers or more.

    A finger is all that hangs on one body whose parent does not move.
    """
    end, fingers = Moment.read(folder), set[int]()
    model, touching = end.model, end.find_touching(thing)
    for body in touching:
        while model.body_weldid[body] and model.body_weldid[model.body_parentid[body]]:
            body = int(model.body_parentid[body])
        fingers |= {body} if model.body_weldid[body] else set()
    is_free = not touching & {end.find(name) for name in supports}
    return is_free and len(fingers) >= 2 and _is_at_rest(end, thing)


def is_in_posture(
    folder: Path, robot: str, posture: str, held_s: float = POSED_S, still_rad_s: float = REST_RAD_S
) -> bool:
    """Whether a robot ended in a posture that its profile names, and was measured there for some time before."""
    profile = yaml.safe_load((ROBOTS / robot / "target.yaml").read_text())
    joints = [name for name in profile["arm"]["joints"] if name not in BASE_JOINTS]
    return is_posed(folder, dict(zip(joints, profile["postures"][posture], strict=True)), held_s, still_rad_s)


def is_kept(folder: Path, robot: str, posture: str, body: str, least_m: float) -> bool:
    """Whether a posture was kept for ten seconds by a robot that is pushed, which stands at its height at the end."""
    return is_in_posture(folder, robot, posture, 9.9, 0.2) and is_standing(folder, body, least_m)


def is_within(folder: Path, thing: str, middle_m: Sequence[float], half_m: Sequence[float]) -> bool:
    """Whether the origin of a free body is within a box (3,) along the axes of the world."""
    return bool((np.abs(Moment.read(folder).locate(thing)[1] - middle_m) <= half_m).all())


def is_so(folder: Path, text: str, **regions: Sequence[Sequence[float]]) -> bool:
    """Whether a predicate is true at the end.

    Args:
        folder: An evidence bundle.
        text: As goal graphs have it; what has to do with a beginning counts from the end, too.
        regions: Centre (3,) and half extents (3,) of those that it names [m].
    """
    end = Moment.read(folder)
    boxes = {name: (np.array(center), np.array(half)) for name, (center, half) in regions.items()}
    return Judge({}, boxes, end, end).judge(text) >= 0


def _is_at_rest(end: Moment, name: str) -> bool:
    return end.measure_speed(name) < REST_M_S
