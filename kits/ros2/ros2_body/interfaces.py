"""Messages of ROS by introspection of the installed types: their fields by path, values in and values out.

python -m ros2_body.interfaces robots/NAME/target.yaml   # writes procedures.json there, for `paos lint`
"""

import importlib
import itertools
import json
import math
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from target_server.procedures import Procedure
from target_server.settings import SettingsError
from target_server.wire import Refusal

from ros2_body.settings import FILE, Offer, read_settings

DEPTH_MAX, FIELDS_MAX, ITEMS_MAX = 8, 500, 1000  # of one message, of all its fields, of one list
UNIT_TOLERANCE = 0.01
KINDS = {"action": "action", "srv": "service", "msg": "topic"}
_POSES = {"geometry_msgs/Pose": "pose", "geometry_msgs/PoseStamped": "pose",
          "geometry_msgs/Point": "point", "geometry_msgs/PointStamped": "point"}  # fmt: skip
_SCALARS = {"boolean": "boolean", "string": "string", "wstring": "string", "float": "number", "double": "number"}
_SCALARS |= {f"{sign}int{bits}": "integer" for sign in ("", "u") for bits in (8, 16, 32, 64)}


@cache
def load_type(name: str) -> Any:
    """The class of `package/kind/Name`; of a message, `package/Name` will do.

    Raises:
        ValueError: No such type is installed.
    """
    if (parts := re.fullmatch(r"(\w+)/(?:(action|srv|msg)/)?(\w+)", name)) is None:
        raise ValueError(f"{name!r} is no package/action/Name, package/srv/Name or package/msg/Name")
    package, kind, bare = parts[1], parts[2] or "msg", parts[3]
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), bare)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"{name} is not installed: {error}") from error


def load_installed(name: str, key: str) -> Any:
    """As `load_type`, for a key of `ros2.yaml`; raises `SettingsError`."""
    try:
        return load_type(name)
    except ValueError as error:
        raise SettingsError(f"{FILE}: {key}", str(error), "an installed type") from error


def describe_procedure(name: str, offer: Offer) -> Procedure:
    """What can be called under a name; raises `SettingsError` where its type is not installed."""
    found, what = load_installed(offer.type, f"procedures.{name}.type"), KINDS[offer.type.split("/")[1]]
    if what == "action":
        parts = (found.Goal, found.Feedback, found.Result)
    elif what == "service":
        parts = (found.Request, None, found.Response)
    else:
        parts = (None, None, found) if offer.listen else (found, None, None)
    return Procedure(name, what, offer.type, *({} if each is None else describe(each) for each in parts))


def describe(message: Any) -> dict[str, str]:
    """Type of each field by its path, as of `target_server.procedures.Procedure`; bytes are left out."""
    return dict(itertools.islice(_iter_fields(message, "", 0), FIELDS_MAX))


def _iter_fields(message: Any, above: str, depth: int) -> Iterator[tuple[str, str]]:
    for name, declared in message.get_fields_and_field_types().items():
        element, is_list = _parse(declared)
        path, mark = above + name, "[]" if is_list else ""
        if element in _SCALARS:
            yield path, _SCALARS[element] + mark
        elif "/" in element and depth < DEPTH_MAX:
            if element in _POSES:
                yield path + mark, _POSES[element]
            yield from _iter_fields(load_type(element), f"{path}{mark}.", depth + 1)


def _parse(declared: str) -> tuple[str, bool]:
    """Type of an element, and whether there is a list of it: `sequence<int32, 3>`, `double[36]`, `string<10>`."""
    is_list = declared.startswith("sequence<") or declared.endswith("]")
    return declared.removeprefix("sequence<").split("<")[0].split("[")[0].split(",")[0].rstrip(">"), is_list


def fill(message: Any, values: Mapping[str, Any], frame: str) -> Any:
    """The message with these values by path; `frame` is that of poses and points whose header names none.

    Raises:
        Refusal: `REQUEST_INVALID` for a path that is none, or a value that does not fit.
    """
    for path, value in values.items():
        try:
            _assign(message, path, value, frame)
        except (AssertionError, AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
            says = str(error).partition("\n")[0]
            raise Refusal("REQUEST_INVALID", f"{path}: {value!r} does not fit: {says}") from error
    return message


def _assign(message: Any, path: str, value: Any, frame: str) -> None:
    if (step := re.fullmatch(r"(\w+)(?:\.(\d{1,3}))?(?:\.(.+))?", path)) is None:
        raise KeyError(path)
    name, index, below = step.groups()
    element, _ = _parse(message.get_fields_and_field_types()[name])
    holder = getattr(message, name)
    if index is not None:
        while len(holder) <= int(index):
            holder.append(load_type(element)())
        setattr(message, name, holder)  # which looks at its bound
        holder = holder[int(index)]
    if below:
        _assign(holder, below, value, frame)
    elif element in _POSES:
        _place(holder, value, frame)
    else:
        setattr(message, name, float(value) if _SCALARS.get(element) == "number" and type(value) is int else value)


def _place(holder: Any, value: Any, frame: str) -> None:
    """A pose or a point into its message, stamped or not."""
    if hasattr(holder, "header"):
        holder.header.frame_id = holder.header.frame_id or frame
        holder = holder.pose if hasattr(holder, "pose") else holder.point
    point = holder
    if hasattr(holder, "orientation"):
        turn, point = holder.orientation, holder.position
        turn.w, turn.x, turn.y, turn.z = map(float, value["quaternion_wxyz"])
        value = value["position_m"]
    point.x, point.y, point.z = map(float, value)


def read(message: Any, types: Mapping[str, str]) -> dict[str, Any]:
    """Values by path, without elements of lists; left out is what is not finite, no turn, or too long."""
    found = {}
    for path, kind in types.items():
        if "[]" in path:
            continue
        value = message
        for name in path.split("."):
            value = getattr(value, name)
        if kind in ("pose", "point"):
            value = _read_place(value)
        elif kind.endswith("[]"):
            value = [each.item() if hasattr(each, "item") else each for each in value[: ITEMS_MAX + 1]]
        if _is_sound(value):
            found[path] = value
    return found


def _read_place(holder: Any) -> Any:
    holder = getattr(holder, "pose", getattr(holder, "point", holder))
    point, turn = getattr(holder, "position", holder), getattr(holder, "orientation", None)
    position_m = [point.x, point.y, point.z]
    if turn is None:
        return position_m
    return {"position_m": position_m, "quaternion_wxyz": [turn.w, turn.x, turn.y, turn.z]}


def _is_sound(value: Any) -> bool:
    if isinstance(value, dict):
        is_turn = abs(math.hypot(*value["quaternion_wxyz"]) - 1.0) < UNIT_TOLERANCE
        return is_turn and _is_sound(value["position_m"])
    if isinstance(value, list):
        return len(value) <= ITEMS_MAX and all(map(_is_sound, value))
    return not isinstance(value, float) or math.isfinite(value)


def main(arguments: list[str]) -> int:
    """Write what the installed types say of the procedures of a profile; the exit code."""
    try:
        (profile,) = map(Path, arguments)
        offers = read_settings(profile).ros.procedures
        found = [vars(describe_procedure(name, each)) for name, each in offers.items()]
    except (ValueError, SettingsError) as error:
        print(
            error if isinstance(error, SettingsError) else "usage: python -m ros2_body.interfaces PROFILE",
            file=sys.stderr,
        )
        return 2
    path = profile.with_name("procedures.json")
    path.write_text(json.dumps(found, indent=1), encoding="utf-8")
    print(f"wrote {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
