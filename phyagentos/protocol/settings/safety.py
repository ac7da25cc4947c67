"""safety.yaml: what the guard enforces, for each target. People own it; no skill, tree, prompt or memory can write it.

Each limit names where its number comes from.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import pydantic

from phyagentos.errors import DefinitionError, Problem, format_names, raise_any
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Authored, Located, advise_corners, read_yaml, show_value, validate

Provenance = Literal["controller_enforced", "planner_constrained", "site_policy", "measured"]
Reaction = Literal["refuse", "stop_category_1", "stop_category_2", "clamp"]

UNITS = {
    "joint_position_min": "rad",
    "joint_position_max": "rad",
    "joint_velocity_max": "rad/s",
    "joint_acceleration_max": "rad/s^2",
    "joint_jerk_max": "rad/s^3",
    "workspace_box": "m",
    "gripper_width_max": "m",
    "gripper_force_max": "N",
    "command_rate_max": "1/s",
    "command_validity_max": "s",
    "session_duration_max": "s",
    "tracking_error_max": "rad",
}
CONVERSIONS = {"deg": "Multiply degrees by pi / 180.", "mm": "Divide by 1000.", "cm": "Divide by 100."}
BOXES = ("workspace_box", "keep_out")
PER_JOINT = tuple(name for name in UNITS if name.startswith("joint_"))  # one number, or one per joint
NO_SOURCE = {"", "?", "-", "n/a", "none", "unknown", "tbd", "todo", "guess", "guessed"}
GUARDED = (  # codes of what the guard finds
    "ESTOPPED", "EXPIRED", "EXPIRY_TOO_LATE", "RATE", "SESSION_TOO_LONG", "WRONG_SHAPE", "NOT_FINITE",
    "JOINT_POSITION", "JOINT_VELOCITY", "JOINT_ACCELERATION", "JOINT_JERK", "SET_POINTS_DISAGREE",
    "GRIPPER_WIDTH", "GRIPPER_FORCE", "WORKSPACE", "KEEP_OUT", "COLLISION",
)  # fmt: skip
SOURCES = "Name the data sheet, the standard, the measurement or the policy of the site."
CLAMPABLE = ("JOINT_POSITION", "GRIPPER_WIDTH")  # what can be projected without making it worse


class Limit(Authored):
    """One bound with its origin; an unsourced limit is refused at load.

    Attributes:
        value: A number, or one number per joint, or a box as ((x, y, z), (x, y, z)) minimum and maximum.
        unit: `rad`, `rad/s`, `rad/s^2`, `m`, `1/s`, ...
        source: Where the number comes from (datasheet, standard, measurement).
        provenance: Who else stands behind it.
    """

    value: float | tuple[float, ...] | tuple[tuple[float, float, float], tuple[float, float, float]]
    unit: str
    source: str
    provenance: Provenance


def _say_nothing(name: str) -> Limit:
    value: object = () if name in PER_JOINT else ((-1.0,) * 3, (1.0,) * 3) if name in BOXES else 0.0
    value = 1.0 if name == "tracking_error_max" else value
    return Limit.model_validate(
        {"value": value, "unit": UNITS[name], "source": "the target has no joints", "provenance": "site_policy"}
    )


OF_EVERY_TARGET = frozenset({"command_rate_max", "command_validity_max", "session_duration_max"})
WITHOUT_JOINTS = {name: _say_nothing(name) for name in UNITS if name not in OF_EVERY_TARGET}
"""Of a target without joints, whose limits are those of every target; they fit no other one."""


def _require_together(schema: Fields) -> None:
    """For editors: those of joints are given together, or none of them."""
    schema["required"] = sorted(OF_EVERY_TARGET)
    schema["dependentRequired"] = {name: [*WITHOUT_JOINTS] for name in WITHOUT_JOINTS}


class TargetLimits(Authored):
    """What the guard enforces for one target; a list has one number per joint, and one number stands for all of them.

    A target without joints, tool and gripper has the limits of commands and sessions alone, any other one all of them.

    Attributes:
        joint_position_min: Lowest joint positions [rad].
        joint_position_max: Highest joint positions [rad].
        joint_velocity_max: Largest joint velocities [rad/s].
        joint_acceleration_max: Largest joint accelerations [rad/s^2].
        joint_jerk_max: Largest jerk, as the mean of its magnitude over one control period [rad/s^3].
        workspace_box: Where the tool centre point may be, world frame [m].
        keep_out: Boxes that the tool centre point never enters, by name, world frame [m].
        gripper_width_max: Widest opening [m].
        gripper_force_max: Largest force of a finger [N].
        command_rate_max: Most commands in a second of the target's own time [1/s].
        command_validity_max: Longest time from a command to its expiry [s].
        session_duration_max: Longest time from a session's first command to its last [s].
        tracking_error_max: Largest distance between commanded and measured joint position [rad]; an arm that stays
            beyond it for five control periods ends its motion as `STALLED`.
        collision_depth_max: How deep a commanded posture may reach into the robot itself, or into the distance that
            planning keeps from what stands fixed [m]; postures are not tested where it is left out.
        reactions: What is done about a broken limit, by code. By default `ESTOPPED` stops by category 1, `WORKSPACE`,
            `KEEP_OUT` and `COLLISION` by category 2, and everything else is refused. A stop of category 1 also ends the
            session's motion for good, category 2 holds (IEC 60204-1, 9.2.2).
    """

    model_config = pydantic.ConfigDict(json_schema_extra=_require_together)

    joint_position_min: Limit
    joint_position_max: Limit
    joint_velocity_max: Limit
    joint_acceleration_max: Limit
    joint_jerk_max: Limit
    workspace_box: Limit
    keep_out: dict[str, Limit] = {}
    gripper_width_max: Limit
    gripper_force_max: Limit
    command_rate_max: Limit
    command_validity_max: Limit
    session_duration_max: Limit
    tracking_error_max: Limit
    collision_depth_max: Limit | None = None
    reactions: dict[str, Reaction] = {}

    @pydantic.model_validator(mode="before")
    @classmethod
    def _complete(cls, data: object) -> object:
        is_of_none = (
            isinstance(data, dict) and data.keys() >= OF_EVERY_TARGET and not data.keys() & WITHOUT_JOINTS.keys()
        )
        return {**WITHOUT_JOINTS, **data} if isinstance(data, dict) and is_of_none else data

    def iter_limits(self) -> Iterator[tuple[tuple[str, ...], Limit, str]]:
        """Every limit with its path in the file and the unit it must have; none that only fills a gap."""
        for name, unit in UNITS.items():
            if (limit := getattr(self, name)) != WITHOUT_JOINTS.get(name):
                yield (name,), limit, unit
        for name, limit in self.keep_out.items():
            yield ("keep_out", name), limit, "m"
        if self.collision_depth_max is not None:
            yield ("collision_depth_max",), self.collision_depth_max, "m"


class Safety(Authored):
    """safety.yaml.

    Attributes:
        version: Of this format.
        targets: Limits by name of the target; a target without limits never moves.
    """

    version: Literal[1] = 1
    targets: dict[str, TargetLimits]


def read_safety(path: Path) -> Safety:
    """Read safety.yaml; raises DefinitionError with every problem, unsourced limits too, at file:line:column."""
    located = read_yaml(path)
    safety = validate(Safety, located)
    problems = [
        problem for target, limits in safety.targets.items() for problem in _check_limits(located, target, limits)
    ]
    raise_any(problems)
    return safety


def _check_limits(located: Located, target: str, limits: TargetLimits) -> Iterator[Problem]:
    for path, limit, unit in limits.iter_limits():
        at = ("targets", target, *path)
        if limit.source.strip().lower() in NO_SOURCE:
            yield located.problem(
                "MISSING_VALUE", (*at, "source"), repr(limit.source), "where the number comes from", SOURCES
            )
        if limit.unit != unit:
            yield located.problem(
                "INVALID_VALUE",
                (*at, "unit"),
                repr(limit.unit),
                repr(unit),
                CONVERSIONS.get(limit.unit.split("/")[0], ""),
            )
        if path[0] in BOXES:
            yield from _check_box(located, (*at, "value"), limit)
        elif isinstance(limit.value, tuple) and not _is_per_joint(path[0], limit.value):
            expected = "one number, or one per joint" if path[0] in PER_JOINT else "one number"
            hint = f"Write {limit.value[0]}." if len(limit.value) == 1 else "Write one number."
            yield located.problem("INVALID_VALUE", (*at, "value"), str(list(limit.value)), expected, hint)
        elif path[0].startswith("gripper_") and min(as_numbers(limit)) == 0.0:
            continue  # nothing opens
        elif path[0] not in {"joint_position_min", "joint_position_max"} and min(as_numbers(limit)) <= 0.0:
            wrong = format_names(f"{each:g}" for each in as_numbers(limit) if each <= 0.0)
            yield located.problem("INVALID_VALUE", (*at, "value"), wrong, "greater than 0", "Write its magnitude.")
    yield from _check_joints(located, target, limits)
    for code, reaction in limits.reactions.items():
        at = ("targets", target, "reactions", code)
        if code not in GUARDED:
            yield located.unknown("key", at, code, GUARDED)
        elif reaction == "clamp" and code not in CLAMPABLE:
            hint = f"Only {format_names(CLAMPABLE)} can be clamped."
            yield located.problem("INVALID_VALUE", at, "clamp", "refuse, or a stop", hint)


def _is_per_joint(name: str, values: tuple[object, ...]) -> bool:
    return name in PER_JOINT and bool(values) and all(isinstance(each, float | int) for each in values)


def _check_joints(located: Located, target: str, limits: TargetLimits) -> Iterator[Problem]:
    """Lists are of one length, and each joint has some way to go."""
    values = {name: as_numbers(getattr(limits, name)) for name in PER_JOINT}
    (size, _), *_ = Counter(len(each) for each in values.values() if len(each) > 1).most_common() or [(1, 0)]
    for name, numbers in values.items():
        if numbers and len(numbers) not in {1, size}:
            expected, more = f"one, or {size}: one per joint, as in the other lists", size - len(numbers)
            hint = f"Add {more}." if more > 0 else f"Remove {-more}."
            yield located.problem(
                "INVALID_VALUE", ("targets", target, name, "value"), f"{len(numbers)} values", expected, hint
            )
    low, high = ((each * size)[:size] for each in (values["joint_position_min"], values["joint_position_max"]))
    for joint, (least, most) in enumerate(zip(low, high, strict=False), 1):
        if least >= most:
            place, found = ("targets", target, "joint_position_max", "value"), f"{most:g} for joint {joint}"
            hint = f"Write the greater of both here, and {min(least, most):g} there."
            yield located.problem("INVALID_VALUE", place, found, f"more than its joint_position_min, {least:g}", hint)


def _check_box(located: Located, at: tuple[str, ...], limit: Limit) -> Iterator[Problem]:
    corners = [each for each in limit.value if isinstance(each, tuple)] if isinstance(limit.value, tuple) else []
    if len(corners) != 2:
        found, expected = show_value(limit.value), "two corners of three numbers, least and greatest"
        yield located.problem("INVALID_VALUE", at, found, expected, "Write [[x, y, z], [x, y, z]].")
    elif advice := advise_corners((corners[0], corners[1])):
        yield located.problem("INVALID_VALUE", at, show_value(corners), "the least corner first", advice)


def as_numbers(limit: Limit) -> tuple[float, ...]:
    """The numbers of a limit that is no box: one, or one per joint."""
    values = limit.value if isinstance(limit.value, tuple) else (limit.value,)
    return tuple(value for value in values if not isinstance(value, tuple))


def get_target_limits(safety: Safety, target: str, source: str) -> TargetLimits:
    """The limits of one target; raises DefinitionError `MISSING_VALUE`: nothing moves without limits."""
    if target not in safety.targets:
        found = f"no limits for target {target!r}"
        hint = f"Add targets.{target} with a source for each limit."
        raise DefinitionError.of("MISSING_VALUE", source, found, format_names(safety.targets), hint)
    return safety.targets[target]
