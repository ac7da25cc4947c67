"""The operations that a session is granted, each with the schema of its arguments. Paper section 4.2.

Upstream: what skill, target and site agree on; the live target, whose shapes and ranges the schemas hold. Downstream:
the TargetToolManifest: its names in the journal and at the handle, its schemas shown to callers of a tool.
"""

from collections.abc import Iterable
from typing import Any

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.settings.operations import Operation
from phyagentos.runtime.preflight.adapter_plan import Tool
from phyagentos.runtime.targets.wire import Description

_SAYS: dict[Operation, str] = {
    "apply": "Carry out one control period of set-points.",
    "observe": "Look; time does not move.",
    "halt": "Come to rest by the target's own means, and hold.",
    "settle": "Hold still for some time of the target.",
    "render": "Take a picture; time does not move.",
    "reset": "Begin the scene anew.",
    "home": "Go to the home posture.",
}


def make_tools(granted: Iterable[Operation], profile: TargetProfile, live: Description) -> tuple[Tool, ...]:
    """One tool for each operation, in this order."""
    schemas: dict[Operation, dict[str, Any]] = {
        "apply": _make_apply(profile, live),
        "halt": _make_object({"category": {"enum": [1, 2]}}, required=()),
        "settle": _make_object({"duration_s": {"type": "number", "exclusiveMinimum": 0}}),
        "render": _make_object(
            {
                "camera": {"enum": list(live.cameras)},
                "width": {"type": "integer", "minimum": 1},
                "height": {"type": "integer", "minimum": 1},
            },
            required=("camera",),
        ),
    }
    return tuple(
        Tool(name=each, description=_SAYS[each], arguments=schemas.get(each, _make_object({}))) for each in granted
    )


def _make_apply(profile: TargetProfile, live: Description) -> dict[str, Any]:
    rows = live.steps_per_command
    joints = [
        {"title": name, "type": "number", "minimum": low, "maximum": high}
        for name, low, high in zip(profile.arm.joints, live.q_min_rad, live.q_max_rad, strict=False)
    ]
    speeds = [{"type": "number", "minimum": -each, "maximum": each} for each in profile.arm.velocity_rad_s]
    opening = {"type": "number", "minimum": 0, "maximum": profile.gripper.max_width_m}
    return _make_object(
        {
            "q_rad": _make_rows(
                rows, {"type": "array", "prefixItems": joints, "minItems": len(joints), "items": False}
            ),
            "qd_rad_s": _make_rows(
                rows, {"type": "array", "prefixItems": speeds, "minItems": len(speeds), "items": False}
            ),
            "gripper_width_m": _make_rows(rows, opening),
        }
    )


def _make_rows(count: int, each: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": each, "minItems": count, "maxItems": count}


def _make_object(properties: dict[str, Any], required: Iterable[str] | None = None) -> dict[str, Any]:
    needed = list(properties if required is None else required)
    return {"type": "object", "properties": properties, "required": needed, "additionalProperties": False}
