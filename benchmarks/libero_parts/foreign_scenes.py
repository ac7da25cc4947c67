"""A scene file for a world that another program simulates, from the objects that it describes.

The scene file names objects, kinds and geometry for who writes or checks goals, and perception. Where objects really
are, the target observes: of what moves freely, and of how far a joint is open, it says nothing.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from phyagentos.protocol.world.environment import Entity, Pose, Shape

LEAST_M = 1e-4  # of a half size
DIGITS = 6
AWAY_M = 100.0  # a height for what may be anywhere: it is in the way of nothing where it is not
Span = tuple[float, float]
Look = Sequence[Sequence[Sequence[float]]]
ANYWHERE_M: Sequence[Span] = ((-0.6, 1.1), (-0.95, 0.95))  # of x and y, in the frame of the robot's base


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What is known of a scene beforehand for the sake of cameras.

    Attributes:
        looks: Colours of each side of each object: rows of red, green, blue and share.
        covers: What is seen of each object beside its solids, in its frame.
        areas: Spans of x and y in which an object begins.
        stand: Solids of what the robot stands on, which is seen and touched by nothing.
    """

    looks: Mapping[str, Look] = field(default_factory=dict)
    covers: Mapping[str, Sequence[Shape]] = field(default_factory=dict)
    areas: Mapping[str, Sequence[Span]] = field(default_factory=dict)
    stand: Sequence[Shape] = ()


def write_scene(
    name: str,
    description: str,
    entities: Iterable[Entity],
    regions: Mapping[str, Mapping[str, Any]],
    seen: "Seen",
) -> str:
    """The text of `scenes/NAME.yaml`.

    Args:
        name: Of the scene.
        description: In words.
        entities: With their shapes; of what stands fixed, and of mechanisms, poses are written down, of what moves
            freely none is.
        regions: By name: `entity`, in whose frame are `center_m` and `half_m`.
        seen: What cameras are told beforehand.
    """
    objects = sorted(entities, key=lambda each: bool(each.part_of))
    spans = {each.name: seen.areas.get(each.name, ANYWHERE_M) for each in objects if _is_free(each)}
    bodies = {each.name: _describe_body(each, seen.looks.get(each.part_of or each.name, ())) for each in objects}
    for each in objects if seen.looks else ():
        shown = list(seen.covers.get(each.name, ()))
        if each.part_of:  # all that moves with it shows how far it has moved
            whole = next(other for other in objects if other.name == each.part_of)
            shown = [*whole.shapes, *seen.covers.get(whole.name, ())]
        middle_m = np.array(bodies[each.name]["place"]["position_m"] if each.part_of else np.zeros(3))
        bodies[each.name]["shapes"] += [_describe_solid(shape, middle_m) | {"decor": True} for shape in shown]
    if seen.stand:
        solids = [_describe_solid(each, np.zeros(3)) | {"decor": True} for each in seen.stand]
        bodies["stand"] = {"kind": "stand", "fixed": True, "shapes": solids}
    spec = {
        "scene": name,
        "description": description,
        "areas": {key: {"x_m": list(x_m), "y_m": list(y_m)} for key, (x_m, y_m) in spans.items()},
        "bodies": _lift_apart(bodies),
        "regions": {
            key: {"center_m": _round(mark["center_m"]), "half_m": _round(mark["half_m"]), "body": mark["entity"]}
            for key, mark in regions.items()
        },
        "cameras": {},
        "settle_s": 0.0,
    }
    return yaml.safe_dump(spec, sort_keys=False, width=120)


def _lift_apart(bodies: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """The bodies, those without a place of their own each at a height where no other is."""
    for index, body in enumerate(body for body in bodies.values() if "area" in body.get("place", ())):
        body["place"]["position_m"] = [0.0, 0.0, AWAY_M + index]
    return bodies


def _is_free(entity: Entity) -> bool:
    """Whether it may be anywhere."""
    return entity.movable and not entity.part_of and entity.mechanism is None


def _describe_solid(shape: Shape, middle_m: Any) -> dict[str, Any]:
    return {
        "kind": str(shape.kind),
        "size_m": _round([max(LEAST_M, size) for size in shape.size_m]),
        "position_m": _round(shape.pose.position_m - middle_m),
        "euler_rad": _find_euler(shape.pose),
    }


def _describe_body(entity: Entity, look: Look) -> dict[str, Any]:
    middle_m = np.mean([shape.pose.position_m for shape in entity.shapes], axis=0) if entity.part_of else np.zeros(3)
    body: dict[str, Any] = {
        "kind": entity.kind,
        "fixed": not entity.movable,
        "shapes": [_describe_solid(shape, middle_m) for shape in entity.shapes],
    }
    if look:
        body["look"] = list(look)
    if entity.datum_m is not None:
        body["datum_m"] = list(entity.datum_m)
    if entity.part_of:
        return body | {"part_of": entity.part_of, "place": {"position_m": _round(middle_m.tolist())}}
    if entity.interior is not None:
        body["interior"] = msgspec.to_builtins(entity.interior)
    if _is_free(entity):
        return body | {"place": {"area": entity.name}}
    pose = entity.mechanism.closed if entity.mechanism is not None else entity.pose
    body["place"] = {"position_m": _round(pose.position_m), "euler_rad": _find_euler(pose)}
    if (how := entity.mechanism) is not None:
        axis = np.array(how.axis) / np.linalg.norm(how.axis)
        body["joint"] = {
            "kind": how.kind,
            "axis": axis.tolist(),
            "anchor_m": _round(how.anchor_m),
            "travel": how.travel,
            "opening": [0.0, 1.0],
            "opens_at": how.opens_at,
            "closes_at": how.closes_at,
        }
    return body


def _find_euler(pose: Pose) -> list[float]:
    """Intrinsic turns about x, y and z [rad]; upright about y, where only their sum counts, the last is zero."""
    w, x, y, z = pose.quaternion_wxyz
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")
        return _round(Rotation.from_quat((x, y, z, w)).as_euler("XYZ").tolist())


def _round(numbers: Sequence[float]) -> list[float]:
    return [round(float(each), DIGITS) for each in numbers]
