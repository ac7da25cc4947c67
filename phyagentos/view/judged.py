"""The number that decided a verdict, beside the object that it concerns, in a picture of the scene.

The picture is the one that was drawn for people, by the camera that the scene's model names first; else that of the
camera that saw the object largest.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from phyagentos.errors import ExecutionError
from phyagentos.geometry import Pose, Vector, as_pose, to_child, to_parent
from phyagentos.protocol.documents.packed_files import check_picture
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.predicates.predicate import find_things
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, SCENE_MODEL, TERMINAL, Bundle
from phyagentos.protocol.sessions.looks import LookRole
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.protocol.world.entity_geometry import compute_half_box
from phyagentos.protocol.world.environment import Entity
from phyagentos.view.frames import read_frames
from phyagentos.view.quantities import find_deciding, format_measure, name_quantity
from phyagentos.view.story import Picture

SHOWN = 2  # objects of one criterion
_LEAST_SHARE, _ROOM = 0.4, 1.7  # of the picture's width that is shown; of what is around the objects


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera: size of its picture and focal length [pixels], pose as OpenCV has it (z forward, y down)."""

    width: int
    height: int
    focal: float
    center: tuple[float, float]
    world_T_camera: Pose

    def find_box(self, entity: Entity) -> "Spot | None":
        """Where an object is in its picture; None where no part of it is."""
        corners = [self._project(point) for point in _iter_corners(entity)]
        found = [each for each in corners if each is not None]
        if not found or len(found) < len(corners):
            return None
        (left, top), (right, bottom) = np.min(found, axis=0), np.max(found, axis=0)
        is_seen = right > 0 and bottom > 0 and left < self.width and top < self.height
        return (
            Spot(entity.name, *(float(each) for each in (left, top, right - left, bottom - top))) if is_seen else None
        )

    def _project(self, point_m: Vector) -> tuple[float, float] | None:
        x, y, z = to_child(self.world_T_camera, point_m)
        return (self.center[0] + self.focal * x / z, self.center[1] + self.focal * y / z) if z > 0 else None


@dataclass(frozen=True, slots=True)
class Spot:
    """An object in a picture [pixels]."""

    name: str
    left: float
    top: float
    width: float
    height: float

    @property
    def middle(self) -> tuple[float, float]:
        """Its centre."""
        return self.left + self.width / 2, self.top + self.height / 2


@dataclass(frozen=True, slots=True)
class JudgedPicture:
    """A picture with the objects of a criterion and its number.

    Attributes:
        spots: The object first, then the place.
        label: The number, beside the object.
        window: Left, top, width, height of the part around them [pixels].
    """

    picture: Picture
    width: int
    height: int
    spots: tuple[Spot, ...]
    label: str
    window: tuple[float, float, float, float]


def find_judged(bundle: Bundle, criterion: Criterion | None) -> JudgedPicture | None:
    """None where nothing was measured, or no picture shows the object; raises ExecutionError `EVIDENCE_DAMAGED`."""
    name = find_deciding(criterion) if criterion is not None else ""
    if criterion is None or not name or bundle.after is None:
        return None
    bound, known = criterion.measured.get("for"), bundle.after.entities
    names = [each for each in (bound, *find_things(criterion.text, bundle.after)) if each in known][:SHOWN]
    for camera, picture in _iter_views(bundle, str(names[0])) if names else ():
        spots = tuple(spot for each in dict.fromkeys(names) if (spot := camera.find_box(known[str(each)])))
        if spots and spots[0].name == names[0]:
            label = f"{name_quantity(name)} {format_measure(criterion.measured[name], name)}"
            return JudgedPicture(picture, camera.width, camera.height, spots, label, _frame(camera, spots))
    return None


def _iter_corners(entity: Entity) -> Iterator[Vector]:
    for shape in entity.shapes:
        half_m = compute_half_box(shape)
        for x, y, z in product((-1, 1), repeat=3):
            yield to_parent(entity.pose, to_parent(shape.pose, (x * half_m[0], y * half_m[1], z * half_m[2])))


def _iter_views(bundle: Bundle, name: str) -> Iterator[tuple[Camera, Picture]]:
    if (bundle.folder / PICTURE_AFTER).is_file() and (bundle.folder / SCENE_MODEL).is_file():
        yield _read_drawn(bundle), Picture("after", bundle.folder, PICTURE_AFTER)
    frames = [each for each in read_frames(bundle) if each.look.role is LookRole.END and each.frame.fy]
    frames.sort(key=lambda each: math.prod(each.seen.get(name, (0, 0))[2:] or (0,)), reverse=True)
    for each in frames:
        frame, picture = each.frame, Picture("after", bundle.folder, each.look.file, each.frame.rgb)
        center = (frame.cx, frame.cy)
        yield Camera(frame.width, frame.height, frame.fy, center, frame.world_T_camera), picture


def _read_drawn(bundle: Bundle) -> Camera:
    """The camera of the picture that was drawn after a session."""
    import mujoco

    try:
        head = check_picture(read_regular(bundle.folder / PICTURE_AFTER))
        model = mujoco.MjModel.from_binary_path(str(bundle.folder / SCENE_MODEL))
        data = mujoco.MjData(model)
        data.qpos[:] = read_arrays(bundle.folder / TERMINAL)["qpos"]
    except (OSError, ValueError, LookupError, mujoco.FatalError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{bundle.folder}: {error}") from error
    width, height = int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    focal = height / 2 / math.tan(math.radians(model.cam_fovy[0]) / 2)
    rotation = data.cam_xmat[0].reshape(3, 3) @ np.diag((1.0, -1.0, -1.0))  # MuJoCo's looks along -z, y up
    return Camera(width, height, focal, (width / 2, height / 2), as_pose(rotation, data.cam_xpos[0]))


def _frame(camera: Camera, spots: tuple[Spot, ...]) -> tuple[float, float, float, float]:
    """The part of the picture around objects, in the shape of the whole."""
    left, top = min(each.left for each in spots), min(each.top for each in spots)
    right, bottom = max(each.left + each.width for each in spots), max(each.top + each.height for each in spots)
    share = max(_LEAST_SHARE, _ROOM * (right - left) / camera.width, _ROOM * (bottom - top) / camera.height)
    width, height = (min(1.0, share) * each for each in (camera.width, camera.height))
    x = min(max((left + right - width) / 2, 0.0), camera.width - width)
    y = min(max((top + bottom - height) / 2, 0.0), camera.height - height)
    return x, y, width, height
