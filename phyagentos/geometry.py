"""Rigid poses and rotations; quaternions are (w, x, y, z), arrays (3, 3) rotations and (4, 4) poses.

A single pose is computed in plain floats: 1 to 4 us a call instead of 30 to 200 us with scipy, whose import takes half
a second. Batches and notations of rotations (`runtime.actions.bridges.rotations`) are scipy's. numpy is imported late,
since protocol and command line start without it.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

UP: Vector = (0.0, 0.0, 1.0)


class Pose(msgspec.Struct, frozen=True):
    """A rigid pose `parent_T_child`.

    Attributes:
        position_m: (3,) [m].
        quaternion_wxyz: (4,) unit quaternion.
    """

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


def rotate(quaternion_wxyz: Sequence[float], v: Sequence[float]) -> Vector:
    """V turned by a unit quaternion: v + 2 u x (u x v + w v), with u the vector part."""
    w, x, y, z = quaternion_wxyz
    tx, ty, tz = y * v[2] - z * v[1] + w * v[0], z * v[0] - x * v[2] + w * v[1], x * v[1] - y * v[0] + w * v[2]
    return (v[0] + 2 * (y * tz - z * ty), v[1] + 2 * (z * tx - x * tz), v[2] + 2 * (x * ty - y * tx))


def invert_rotation(quaternion_wxyz: Sequence[float]) -> Quaternion:
    """The opposite turn of a unit quaternion."""
    w, x, y, z = quaternion_wxyz
    return (w, -x, -y, -z)


def multiply(a: Sequence[float], b: Sequence[float]) -> Quaternion:
    """The quaternion that turns by `b` first, then by `a`."""
    w, x, y, z = a
    p, q, r, s = b
    return (
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    )


def convert_euler(euler_rad: Sequence[float]) -> Quaternion:
    """The quaternion of intrinsic x-y-z angles [rad], as MuJoCo's `eulerseq="xyz"`."""
    turned: Quaternion = (1.0, 0.0, 0.0, 0.0)
    for axis, angle in enumerate(euler_rad):
        step = [math.cos(angle / 2), 0.0, 0.0, 0.0]
        step[1 + axis] = math.sin(angle / 2)
        turned = multiply(turned, step)
    return turned


def to_parent(pose: Pose, point: Sequence[float]) -> Vector:
    """A point of the child frame, in the parent frame."""
    x, y, z = rotate(pose.quaternion_wxyz, point)
    a, b, c = pose.position_m
    return (x + a, y + b, z + c)


def to_child(pose: Pose, point: Sequence[float]) -> Vector:
    """A point of the parent frame, in the child frame."""
    a, b, c = pose.position_m
    return rotate(invert_rotation(pose.quaternion_wxyz), (point[0] - a, point[1] - b, point[2] - c))


def compute_tilt(pose: Pose) -> float:
    """Angle [rad] between the frame's z axis and the world's."""
    return math.acos(max(-1.0, min(1.0, rotate(pose.quaternion_wxyz, UP)[2])))


def compute_heading(quaternion_wxyz: Sequence[float]) -> float:
    """Turn [rad] about the world's z axis: whatever the frame leans by, one more turn about that axis adds to it."""
    return 2.0 * math.atan2(quaternion_wxyz[3], quaternion_wxyz[0])


def compute_turn(a: Pose, b: Pose) -> float:
    """Smallest angle [rad] that turns a into b."""
    w, x, y, z = a.quaternion_wxyz
    p, q, r, s = b.quaternion_wxyz
    return 2 * math.acos(min(1.0, abs(w * p + x * q + y * r + z * s)))


def compute_rotation(quaternion_wxyz: "Sequence[float] | Array") -> "Array":
    """(3, 3) rotation of a quaternion; it need not have unit length."""
    import numpy as np

    w, x, y, z = map(float, quaternion_wxyz)
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return np.array(
        (
            (1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
            (s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)),
            (s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)),
        )
    )


def compute_quaternion(rotation: "Array") -> Quaternion:
    """Unit quaternion of a (3, 3) rotation, w not negative (Shepperd, J. Guidance and Control 1(3), 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    trace, largest = a + e + i, max(a, e, i)
    if trace >= largest:
        w, x, y, z = 1.0 + trace, h - f, c - g, d - b
    elif a == largest:
        w, x, y, z = h - f, 1.0 + 2.0 * a - trace, d + b, c + g
    elif e == largest:
        w, x, y, z = c - g, d + b, 1.0 + 2.0 * e - trace, h + f
    else:
        w, x, y, z = d - b, c + g, h + f, 1.0 + 2.0 * i - trace
    scale = (-1.0 if w < 0.0 else 1.0) / math.sqrt(w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)


def turn(vector_rad: "Sequence[float] | Array") -> "Array":
    """(3, 3) rotation about a vector (3,) by its length [rad]."""
    x, y, z = map(float, vector_rad)
    angle = math.sqrt(x * x + y * y + z * z)
    share = math.sin(angle / 2) / angle if angle > 0.0 else 0.5
    return compute_rotation((math.cos(angle / 2), share * x, share * y, share * z))


def compute_rotation_vector(rotation: "Array") -> Vector:
    """Axis times angle in 0..pi [rad] of a (3, 3) rotation; the inverse of `turn`."""
    w, x, y, z = compute_quaternion(rotation)
    sine = math.sqrt(x * x + y * y + z * z)
    share = 2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 2.0
    return (share * x, share * y, share * z)


def compute_matrix(pose: Pose) -> "Array":
    """The (4, 4) matrix of a pose."""
    return make_matrix(compute_rotation(pose.quaternion_wxyz), pose.position_m)


def make_matrix(rotation: "ArrayLike", position_m: "ArrayLike") -> "Array":
    """The (4, 4) matrix of a (3, 3) rotation and a position (3,) [m]."""
    import numpy as np

    T = np.zeros((4, 4))
    T[:3, :3], T[:3, 3], T[3, 3] = rotation, position_m, 1.0
    return T


def compute_pose(T: "Array") -> Pose:
    """The pose of a (4, 4) matrix."""
    return as_pose(T[:3, :3], T[:3, 3])


def as_pose(rotation: "Array", position_m: "Array") -> Pose:
    """The pose of a (3, 3) rotation and a position (3,) [m]."""
    x, y, z = position_m.tolist()
    return Pose((x, y, z), compute_quaternion(rotation))


def compute_inverse(T: "Array") -> "Array":
    """The inverse of a rigid (4, 4) pose."""
    return make_matrix(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])
