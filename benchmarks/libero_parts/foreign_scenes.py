"""A scene file for a world that another program simulates, from the things that it describes.

The scene file names things, kinds and geometry for whoever writes or checks goals; where things really are, the target
observes.
"""

import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from phyagentos.protocol.world.environment import Entity, Pose, Region

LEAST_M = 1e-4  # of a half size
DIGITS = 6


def write_scene(name: str, description: str, entities: Iterable[Entity], regions: Iterable[Region]) -> str:
    """The text of `scenes/NAME.yaml`."""
    spec = {
        "scene": name,
        "description": description,
        "bodies": {each.name: _describe_body(each) for each in sorted(entities, key=lambda each: bool(each.part_of))},
        "regions": {
            each.name: {"center_m": _round(each.pose.position_m), "half_m": _round(each.half_m)} for each in regions
        },
        "cameras": {},
        "settle_s": 0.0,
    }
    return yaml.safe_dump(spec, sort_keys=False, width=120)


def _describe_body(entity: Entity) -> dict[str, Any]:
    pose = entity.mechanism.closed if entity.mechanism is not None else entity.pose
    body: dict[str, Any] = {
        "kind": entity.kind,
        "fixed": not entity.movable,
        "shapes": [
            {
                "kind": str(shape.kind),
                "size_m": _round([max(LEAST_M, size) for size in shape.size_m]),
                "position_m": _round(shape.pose.position_m),
                "euler_rad": _find_euler(shape.pose),
            }
            for shape in entity.shapes
        ],
    }
    if entity.part_of:
        return body | {"part_of": entity.part_of}  # its solids stand in the frame of its whole
    body["place"] = {"position_m": _round(pose.position_m), "euler_rad": _find_euler(pose)}
    if entity.interior is not None:
        body["interior"] = msgspec.to_builtins(entity.interior)
    if (how := entity.mechanism) is not None:
        axis = np.array(how.axis) / np.linalg.norm(how.axis)
        body["joint"] = {
            "kind": how.kind,
            "axis": axis.tolist(),
            "anchor_m": _round(how.anchor_m),
            "travel": how.travel,
            "opening": [entity.joint or 0.0] * 2,
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
