"""Settings of a served robot: `target.yaml` of the framework's side, and a file beside it, read strictly.

Upstream: `paos robot`, which drafts both. Downstream: a body.
"""

import dataclasses
import difflib
import math
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


class SettingsError(Exception):
    """A file that cannot be used: where, what was found, what is possible."""

    def __init__(self, where: str, found: str, expected: str) -> None:
        super().__init__(f"{where}: found {found}; expected {expected}")


@dataclass(frozen=True)
class Tool:
    """The tool centre point in the world with all joints at zero."""

    position_m: Triple
    quaternion_wxyz: Quadruple


@dataclass(frozen=True)
class Profile:
    """What `target.yaml` says of the robot, in its words."""

    target: str
    joints: tuple[str, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    period_s: float
    step_s: float
    width_max_m: float
    finger_speed_m_s: float
    finger_force_n: float
    end_effector: str


def read_profile(path: Path) -> Profile:
    """Of a file `target.yaml`; raises `SettingsError` at the first fault."""
    given, place = read_yaml(path), str(path)
    arm, gripper = (_get(given, place, name, dict) for name in ("arm", "gripper"))
    names = tuple(_get(arm, f"{place}: arm", "joints", list))
    speeds, brakes = (
        tuple(float(each) for each in _get(arm, f"{place}: arm", name, list))
        for name in ("velocity_rad_s", "acceleration_rad_s2")
    )
    if not len(names) == len(speeds) == len(brakes):
        raise SettingsError(f"{place}: arm", f"lists of {len(names)}, {len(speeds)}, {len(brakes)}", "equal lengths")
    return Profile(
        target=str(_get(given, place, "target", str)), joints=names, velocity=speeds, acceleration=brakes,
        period_s=float(given.get("control_period_s", 0.02)), step_s=float(given.get("physics_step_s", 0.002)),
        width_max_m=float(gripper.get("max_width_m", 0.0)), finger_speed_m_s=float(gripper.get("speed_m_s", 0.1)),
        finger_force_n=float(gripper.get("force_n", 0.0)), end_effector=str(given.get("end_effector", "opening")),
    )  # fmt: skip


def check_names(profile: Profile, joints: Mapping[str, Any], place: str) -> None:
    """Whether a file at `place` has an entry for each joint of the profile, and no other; raises `SettingsError`."""
    for name in sorted({*profile.joints} ^ {*joints}):
        where = "joint of target.yaml without an entry" if name in profile.joints else "joint that target.yaml lacks"
        raise SettingsError(f"{place}: joints", f"{name!r}, a {where}", f"exactly {', '.join(profile.joints)}")


def read_yaml(path: Path) -> Mapping[str, Any]:
    """A mapping; raises `SettingsError` for a file that is none."""
    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise SettingsError(str(path), str(error).replace("\n", " "), "a YAML file") from error
    if not isinstance(found, dict):
        raise SettingsError(str(path), f"a {type(found).__name__}", "a mapping")
    return found


def _get(given: Mapping[str, Any], place: str, name: str, kind: type) -> Any:
    value = given.get(name, {} if kind is dict else None)
    if not isinstance(value, kind):
        raise SettingsError(f"{place}: {name}", repr(value), f"a {kind.__name__}")
    return value


def convert(value: Any, kind: Any, place: str) -> Any:
    """A value of YAML as a type of dataclasses; every key is known, every number finite."""
    if dataclasses.is_dataclass(kind):
        return _convert_fields(value, kind, place)
    if kind is Any:
        return value
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if type(None) in arguments:
        return None if value is None else convert(value, arguments[0], place)
    if origin is not None and issubclass(origin, Mapping):
        if not isinstance(value, dict):
            raise SettingsError(place, repr(value), "a mapping")
        return {str(key): convert(each, arguments[1], f"{place}.{key}") for key, each in value.items()}
    if origin is tuple:
        n = None if arguments[-1] is Ellipsis else len(arguments)
        if not isinstance(value, list) or (n is not None and len(value) != n):
            raise SettingsError(place, repr(value), f"a list of {n or 'any number of'} values")
        return tuple(convert(each, arguments[0], f"{place}[{index}]") for index, each in enumerate(value))
    if kind is float and type(value) in (int, float) and math.isfinite(value):
        return float(value)
    if kind is float or type(value) is not kind:
        raise SettingsError(place, repr(value), {float: "a finite number", str: "a text", bool: "true or false"}[kind])
    return value


def _convert_fields(value: Any, kind: Any, place: str) -> Any:
    if not isinstance(value, dict):
        raise SettingsError(place, repr(value), "a mapping")
    types = typing.get_type_hints(kind)
    at = f"{place}: " if place.endswith(".yaml") else f"{place}."
    for key in value:
        if key not in types:
            near = difflib.get_close_matches(str(key), types, 1)
            raise SettingsError(at + str(key), "an unknown key", f"one of {', '.join(near or types)}")
    needed = [
        each.name for each in dataclasses.fields(kind) if each.default is each.default_factory is dataclasses.MISSING
    ]
    if missing := [name for name in needed if name not in value]:
        raise SettingsError(at + missing[0], "nothing", "a value")
    return kind(**{key: convert(each, types[key], at + key) for key, each in value.items()})
