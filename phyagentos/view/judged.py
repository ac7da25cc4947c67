"""The number that decided a verdict, beside the object that it concerns, in a picture of the scene.

The picture is the one that was drawn for people, by the camera that the scene's model names first; else that of the
camera that saw the object largest.
"""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from phyagentos.geometry import as_pose, to_child, to_parent
from phyagentos.pictures.playback import Playback
from phyagentos.protocol.documents.packed_files import check_picture
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.predicates.predicate import find_objects
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, Bundle
from phyagentos.protocol.sessions.looks import LookRole, StoredFrame
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.entity_geometry import compute_half_box
from phyagentos.protocol.world.environment import Entity
from phyagentos.view.frames import read_frames
from phyagentos.view.quantities import find_deciding
from phyagentos.view.story import Picture

SHOWN = 2  # objects of one criterion
Box = tuple[float, float, float, float]
"""Left, top, width, height of an object in a picture [pixels]."""


@dataclass(frozen=True, slots=True)
class JudgedPicture:
    """A picture of size and camera as `frame` has them, the objects in it, the object of the criterion first."""

    picture: Picture
    frame: StoredFrame
    boxes: dict[str, Box]
    quantity: str


def find_judged(bundle: Bundle, criterion: Criterion, playback: Playback | None) -> JudgedPicture | None:
    """None where nothing was measured, or no picture shows the object; raises as `read_frames`, and ValueError."""
    quantity, world = find_deciding(criterion), bundle.after
    if not quantity or world is None:
        return None
    objects = (str(criterion.measured.get("for")), *find_objects(criterion.text, world))
    entities = [world.entities[each] for each in dict.fromkeys(objects) if each in world.entities][:SHOWN]
    for picture, frame in _list_views(bundle, entities[0].name, playback) if entities else ():
        boxes = {each.name: box for each in entities if (box := _find_box(frame, each))}
        if entities[0].name in boxes:
            return JudgedPicture(picture, frame, boxes, quantity)
    return None


def _list_views(bundle: Bundle, name: str, playback: Playback | None) -> list[tuple[Picture, StoredFrame]]:
    seen = [each for each in read_frames(bundle) if each.look.role is LookRole.END and each.frame.fy]
    seen.sort(key=lambda each: math.prod(each.seen.get(name, (0, 0, 0, 0))[2:]), reverse=True)
    views = [(Picture("after", bundle.folder, each.look.file, each.frame.rgb), each.frame) for each in seen]
    if playback is not None and playback.model.ncam and (bundle.folder / PICTURE_AFTER).is_file():
        views.insert(0, (Picture("after", bundle.folder, PICTURE_AFTER), _describe_drawn(bundle, playback)))
    return views


def _describe_drawn(bundle: Bundle, playback: Playback) -> StoredFrame:
    """The camera of the picture that was drawn after a session."""
    head = check_picture(read_regular(bundle.folder / PICTURE_AFTER))
    width, height = int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
    data = playback.pose(float(playback.time_s[-1]))
    focal = height / 2 / math.tan(math.radians(playback.model.cam_fovy[0]) / 2)
    rotation = data.cam_xmat[0].reshape(3, 3) @ np.diag((1.0, -1.0, -1.0))  # MuJoCo's looks along -z, y up
    return StoredFrame(
        camera="drawn", time_s=data.time, width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2,
        world_T_camera=as_pose(rotation, data.cam_xpos[0]), rgb=PICTURE_AFTER, depth_m="",
    )  # fmt: skip


def _find_box(frame: StoredFrame, entity: Entity) -> Box | None:
    """Where an object is in a picture; None where no part of it is."""
    corners = [
        to_child(
            frame.world_T_camera, to_parent(entity.pose, to_parent(shape.pose, np.multiply(half_m, signs).tolist()))
        )
        for shape in entity.shapes
        for half_m, signs in product([compute_half_box(shape)], product((-1, 1), repeat=3))
    ]
    if not corners or min(z for _, _, z in corners) <= 0:
        return None
    across = [float(frame.cx + frame.fx * x / z) for x, _, z in corners]
    down = [float(frame.cy + frame.fy * y / z) for _, y, z in corners]
    is_seen = max(across) > 0 < max(down) and min(across) < frame.width and min(down) < frame.height
    return (min(across), min(down), max(across) - min(across), max(down) - min(down)) if is_seen else None
