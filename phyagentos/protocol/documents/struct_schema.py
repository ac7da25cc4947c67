"""Structs out of located data with every problem at its place, and their JSON Schemas.

msgspec stops at the first problem, so the data is walked along the type first; `schema` does the same for models.
"""

import inspect
import re
from collections.abc import Iterator
from enum import Enum
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

import msgspec

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names, raise_any
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Address, Authored, Located
from phyagentos.protocol.documents.yaml_scalars import advise_form

StructT = TypeVar("StructT")
REFERENCE = "#/$defs/{name}"
_ATTRIBUTE = re.compile(r"^    (?P<name>\w+): (?P<text>.*(?:\n {8}.*)*)", re.MULTILINE)


def convert_located(kind: type[StructT], located: Located, path: Address = ()) -> StructT:
    """The struct of located YAML data, begun at `path`; raises DefinitionError, each violation at file:line:column."""
    value = located.at(path)
    problems = list(_iter_problems(kind, value, located, path))
    raise_any(problems)
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise DefinitionError(located.problem("INVALID_VALUE", path, expected=reword(str(error)))) from error


def build_struct_schema(kind: Any) -> tuple[Fields, Fields]:
    """The JSON Schema of a struct, as (schema, definitions).

    Unknown keys are refused; the docstring of a field becomes its description.
    """
    (schema,), definitions = msgspec.json.schema_components([kind], ref_template=REFERENCE)
    kinds = {each.__name__: each for each in _iter_kinds(kind, set())}
    for name, definition in definitions.items():
        if name in kinds:
            describe(definition, kinds[name])
        if "properties" in definition:
            definition["additionalProperties"] = False
    return schema, definitions


def build_authored_schema(kind: type[Authored]) -> tuple[Fields, Fields]:
    """The JSON Schema of an authored model, as (schema, definitions); docstrings become descriptions."""
    schema = kind.model_json_schema(by_alias=True)
    definitions = schema.pop("$defs", {})
    describe(schema, kind)
    for each in _iter_kinds(kind, set()):
        if each.__name__ in definitions:
            describe(definitions[each.__name__], each)
    return schema, definitions


def describe(definition: Fields, kind: type) -> None:
    """Add the docstrings of a class and its fields to its definition."""
    summary, attributes = _read_docstring(kind)
    if summary:
        definition["description"] = summary
    keys: dict[str, str] = {}
    if issubclass(kind, msgspec.Struct):
        keys = {each.name: each.encode_name for each in msgspec.structs.fields(kind)}
    elif issubclass(kind, Authored):
        keys = {name: field.alias or name for name, field in kind.model_fields.items()}
    for name, text in attributes.items():
        field = keys.get(name, name)
        if field in definition.get("properties", {}):
            definition["properties"][field]["description"] = text


def _iter_problems(kind: Any, value: Any, located: Located, path: Address) -> Iterator[Problem]:
    kind = getattr(kind, "__supertype__", kind)  # a NewType
    origin, args = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        yield from _iter_struct_problems(kind, value, located, path)
    elif origin is dict and isinstance(value, dict):
        for key, each in value.items():
            yield from _iter_problems(args[1], each, located, (*path, key))
    elif origin is tuple and args[-1] is Ellipsis and isinstance(value, list):
        for index, each in enumerate(value):
            yield from _iter_problems(args[0], each, located, (*path, index))
    elif origin in {Union, UnionType} and NoneType in args and len(args) == 2:
        if value is not None:
            yield from _iter_problems(next(arm for arm in args if arm is not NoneType), value, located, path)
    else:
        yield from _iter_leaf_problems(kind, value, located, path)


def _iter_struct_problems(kind: type[msgspec.Struct], value: Any, located: Located, path: Address) -> Iterator[Problem]:
    if not isinstance(value, dict):
        yield located.problem("INVALID_VALUE", path, type(value).__name__, f"a mapping ({kind.__name__})")
        return
    fields = {field.encode_name: field for field in msgspec.structs.fields(kind)}
    for key, each in value.items():
        if key in fields:
            yield from _iter_problems(fields[key].type, each, located, (*path, key))
        else:
            yield located.unknown("key", (*path, key), str(key), fields, found=repr(key))
    for name, field in fields.items():
        if field.required and name not in value:
            yield located.problem("MISSING_VALUE", path, "nothing", f"key {name!r}", f"Add {name!r}.")


_FORMS: dict[Any, tuple[str, str]] = {
    float: ("a number", "number"),
    int: ("a whole number", "integer"),
    bool: ("true or false", "boolean"),
    str: ("a text", "string"),
    dict: ("a mapping", ""),
    tuple: ("a list", ""),
    list: ("a list", ""),
}


def reword(text: str) -> str:
    """What was expected, out of a sentence of msgspec: "Expected `float | null` >= 0, got `str` - at `$.x`"."""
    wanted = re.match(r"Expected `([^`]+)`((?: [<>]=? \S+| matching .*?| of length .*?)?)(?=, got| - at|$)", text)
    if wanted is None:
        return "another value"
    words = {"int": int, "float": float, "bool": bool, "str": str, "object": dict, "array": tuple}
    parts = [_FORMS[words[each]][0] if each in words else each for each in wanted[1].split(" | ")]
    return " or ".join("nothing" if each == "null" else each for each in parts) + wanted[2]


def _iter_leaf_problems(kind: Any, value: Any, located: Located, path: Address) -> Iterator[Problem]:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        shown = repr(value) if isinstance(value, str | int | float | bool | None) else type(value).__name__
        expected, form = _FORMS.get(get_origin(kind) or kind, ("", ""))
        expected, hint = expected or reword(str(error)), advise_form(value, form)
        if isinstance(kind, type) and issubclass(kind, Enum):
            names = [str(member.value) for member in kind]
            expected, hint = format_names(names), format_hint(str(value), names)
        yield located.problem("INVALID_VALUE", path, shown, expected, hint)


def _iter_kinds(kind: Any, seen: set[Any]) -> Iterator[type]:
    """Every struct, authored model and enum that a type is made of."""
    kind = getattr(kind, "__supertype__", kind)
    parts: list[Any] = list(get_args(kind))
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct | Authored | Enum) and kind not in seen:
        seen.add(kind)
        yield kind
        if issubclass(kind, msgspec.Struct):
            parts += [field.type for field in msgspec.structs.fields(kind)]
        elif issubclass(kind, Authored):
            parts += [info.annotation for info in kind.model_fields.values()]
    for part in parts:
        yield from _iter_kinds(part, seen)


def _read_docstring(kind: type) -> tuple[str, dict[str, str]]:
    """The summary and the description of each field, inherited ones included."""
    attributes: dict[str, str] = {}
    for owner in reversed(kind.__mro__):
        if not issubclass(owner, msgspec.Struct | Authored | Enum) or owner in {msgspec.Struct, Authored}:
            continue
        text = owner.__dict__.get("__doc__") or ""
        _, _, listed = inspect.cleandoc(text).partition("Attributes:\n")
        attributes |= {match["name"]: " ".join(match["text"].split()) for match in _ATTRIBUTE.finditer(listed)}
    summary = inspect.cleandoc(kind.__doc__ or "").split("\n\nAttributes:")[0]
    return " ".join(summary.split()), attributes
