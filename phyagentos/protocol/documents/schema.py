"""YAML in, frozen models out: every problem at once, each with file, line and column.

Untyped data (`Any`) enters the project only here. Models are pydantic classes derived from `Authored`, so unknown keys
are refused and the JSON Schema for editors comes from the same source.
"""

import copy
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, reduce
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin

import msgspec
import pydantic
import yaml
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError

from phyagentos.errors import DefinitionError, Problem, find_nearest, format_hint, raise_any
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.documents.yaml_bounds import DEPTH_MAX, FLATTEN, TOO_DEEP, VALUES_MAX, check_bounds, refuse
from phyagentos.protocol.documents.yaml_scalars import (
    Loader,
    advise_form,
    find_key_kind,
    find_old_number,
    format_scalar,
)
from phyagentos.protocol.documents.yaml_syntax import BRACKET_OPEN, BULLETS, QUOTE_OPEN, explain, find_leftover

Address = tuple[str | int, ...]
_Mapping = dict[Any, Any]
ModelT = TypeVar("ModelT", bound="Authored")
_Values = TypeVar("_Values", bound=tuple[float, ...])
Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
MERGE = "tag:yaml.org,2002:merge"  # of the key '<<'
SHOWN = 12  # values of a list that a message shows
SALVAGE_ROUNDS = 4  # dropping a value may make its owner incomplete, and so on up


def _refuse_other_forms(schema: Any) -> None:
    for inner in schema.values() if isinstance(schema, dict) else schema:
        if isinstance(inner, dict | list | tuple):
            _refuse_other_forms(inner)
    if isinstance(schema, dict) and schema.get("type") in ("float", "int", "bool"):
        schema["strict"] = True


class Authored(pydantic.BaseModel):
    """Base of every model that a person writes: frozen, no unknown keys."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", populate_by_name=True, allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: type, handler: pydantic.GetCoreSchemaHandler) -> CoreSchema:
        """Numbers and truth values are themselves: no quoted text, no truth value for a number."""
        schema = handler(source)
        _refuse_other_forms(schema)
        return schema


@dataclass(frozen=True, slots=True)
class AlsoCalled:
    """On a field of a model: names that other programs have for it, to be recognised where they are written."""

    names: tuple[str, ...]


def iter_nested(value: Any) -> Iterator[Any]:
    """A value of plain data, then all that is in it: keys and values of mappings, and elements of lists."""
    yield value
    if isinstance(value, dict | list):
        for each in (*value, *value.values()) if isinstance(value, dict) else value:
            yield from iter_nested(each)


@dataclass(frozen=True, slots=True)
class Located:
    """A YAML value; `marks` gives (line, column) of each path in it, counted from 1, of the key for mapping values.

    `origins` gives the values that come from elsewhere: where each one stands there.
    """

    data: Any
    source: str
    marks: Mapping[Address, tuple[int, int]] = field(default_factory=dict)
    origins: dict[Address, tuple["Located", Address]] = field(default_factory=dict)

    def at(self, path: Address) -> Any:
        """The value at a path; raises KeyError where it is gone."""
        return reduce(operator.getitem, path, self.data)

    def address_of(self, path: Address) -> str:
        """`file:line:column` of the nearest enclosing value that is in the file."""
        for length in range(len(path), -1, -1):
            if path[:length] in self.origins:
                origin, place = self.origins[path[:length]]
                return origin.address_of((*place, *path[length:]))
            mark = self.marks.get(path[:length])
            if mark:
                return f"{self.source}:{mark[0]}:{mark[1]}"
        return self.source

    def problem(self, code: str, path: Address, found: str = "", expected: str = "", hint: str = "") -> Problem:
        """A `Problem` at this place."""
        return Problem(code, self.address_of(path), found, expected, hint)

    def unknown(self, kind: str, path: Address, name: str, possible: Iterable[str], found: str = "") -> Problem:
        """A `Problem.unknown` at this place."""
        possible = tuple(possible)
        fix = "Write one of these." if possible else ""
        return Problem.unknown(kind, self.address_of(path), name, possible, found, fix=fix)


def read_text(path: Path, hint: str = "Check the path and its encoding.") -> str:
    """Read a text file that a person may have written; raises DefinitionError unless it is regular, small and UTF-8."""
    try:
        return read_regular(path).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        head, byte = error.object[: error.start], error.object[error.start]
        *before, line = head.split(b"\n")
        place = f"{path}:{len(before) + 1}:{len(line) + 1}"
        raise DefinitionError.of("UNREADABLE_FILE", place, f"the byte {byte:#04x}", "UTF-8", hint=hint) from error
    except OSError as error:
        raise DefinitionError.of("UNREADABLE_FILE", str(path), str(error), hint=hint) from error


def read_yaml(path: Path) -> Located:
    """Read one YAML file; see `parse_yaml`."""
    return parse_library_yaml(read_text(path), str(path))


def parse_library_yaml(text: str, source: str, first_line: int = 1) -> Located:
    """As `parse_yaml`, for texts that each part of a process reads anew: one that did not change is parsed once."""
    known = _parse_once(text, source, first_line)
    return replace(known, data=copy.deepcopy(known.data), origins={})  # who gets it may change it


@lru_cache(maxsize=256)  # of a library; what sessions write is parsed once anyhow, and must not pile up
def _parse_once(text: str, source: str, first_line: int) -> Located:
    return parse_yaml(text, source, first_line)


def parse_yaml(text: str, source: str, first_line: int = 1, values_max: int = VALUES_MAX) -> Located:
    """Parse one YAML document and record the position of each value.

    `first_line` is the line of the file on which `text` begins, for YAML embedded in Markdown.

    Raises:
        DefinitionError: On a syntax error, a value that does not fit its form or tag, a key written twice, or more than
            `values_max` values once aliases are written out.
    """
    offset = first_line - 1
    marks: dict[Address, tuple[int, int]] = {}
    problems: list[Problem] = []
    try:
        check_bounds(text, values_max)
        loader = Loader(text)
        try:
            node = loader.get_single_node()
            if node is not None:
                _collect_marks(node, (), source, offset, marks, problems)  # first: a merge (`<<`) changes the nodes
            data = loader.construct_document(node) if node is not None else None
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        if leftover := find_leftover(text):
            line, detail, hint = leftover
            raise DefinitionError.of(
                "SYNTAX", f"{source}:{line + first_line}:1", detail, "well-formed YAML", hint
            ) from error
        detail, hint = explain(error, text[mark.index : mark.index + 1] if mark else "")
        opened = getattr(error, "context_mark", None)
        if detail == QUOTE_OPEN or (detail == BRACKET_OPEN and opened and mark and opened.line < mark.line):
            mark = opened
        if isinstance(error, yaml.reader.ReaderError):
            head = text[: error.position]
            mark = yaml.Mark("", error.position, head.count("\n"), len(head) - head.rfind("\n") - 1, None, 0)
        place = f"{source}:{mark.line + 1 + offset}:{mark.column + 1}" if mark else source
        if isinstance(error, yaml.scanner.ScannerError) and mark:  # newer ones have a limit too, and words of their own
            count = text[: mark.index].count
            is_deep = count("[") + count("{") - count("]") - count("}") > DEPTH_MAX
            detail, hint = (TOO_DEEP, f"{FLATTEN.capitalize()}.") if is_deep else (detail, hint)
        raise DefinitionError.of("SYNTAX", place, detail, "well-formed YAML", hint) from error
    raise_any(problems)  # one of an alias is met at each
    return Located(data=data, source=source, marks=marks)


def _collect_marks(
    node: yaml.Node,
    path: Address,
    source: str,
    offset: int,
    marks: dict[Address, tuple[int, int]],
    problems: list[Problem],
) -> None:
    if len(path) > DEPTH_MAX:
        raise refuse(f"{TOO_DEEP}; {FLATTEN}", node.start_mark)
    line, column = node.start_mark.line + 1 + offset, node.start_mark.column + 1
    marks.setdefault(path, (line, column))
    if isinstance(node, yaml.ScalarNode) and (refused := find_old_number(node)):
        problems.append(Problem("INVALID_VALUE", f"{source}:{line}:{column}", *refused))
    elif isinstance(node, yaml.SequenceNode):
        for index, child in enumerate(node.value):
            _collect_marks(child, (*path, index), source, offset, marks, problems)
    elif isinstance(node, yaml.MappingNode):
        seen, merged = dict[str, int](), list[yaml.Node]()
        for key, child in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue  # refused when it is constructed
            line, column = key.start_mark.line + 1 + offset, key.start_mark.column + 1
            if key.value in seen:
                problems.append(
                    Problem(
                        "DUPLICATE_NAME",
                        f"{source}:{line}:{column}",
                        repr(key.value),
                        "each key once",
                        f"Rename or remove one; the first is on line {seen[key.value]}.",
                    )
                )
            seen.setdefault(key.value, line)
            if kind := find_key_kind(key):
                found, hint = f"the key {key.value or 'null'}, {kind}", f"Write '{key.value}' in quotes."
                hint += " A decimal number has a point." if key.value.isdecimal() and not child.value else ""
                problems.append(Problem("INVALID_VALUE", f"{source}:{line}:{column}", found, "a text", hint))
            if key.tag == MERGE:
                merged += child.value if isinstance(child, yaml.SequenceNode) else [child]
                continue
            marks.setdefault((*path, key.value), (line, column))
            _collect_marks(child, (*path, key.value), source, offset, marks, problems)
        for each in merged:  # where it has no key of its own
            _collect_marks(each, path, source, offset, marks, problems)


def validate(model: type[ModelT], located: Located, path: Address = ()) -> ModelT:
    """The frozen model of located YAML data at `path`; raises DefinitionError, each violation at file:line:column."""
    data = located.at(path)
    if not isinstance(data, dict):
        needed = [f"{name}: …" for name, field in model.model_fields.items() if field.is_required()]
        hint = f"Write {{{', '.join(needed)}}}." if needed else _STEPS["dict_type"]
        if isinstance(data, str) and data.startswith("<"):
            hint = "It is XML: `paos import` makes trees of files of BehaviorTree.CPP."
        raise DefinitionError(located.problem("INVALID_VALUE", path, show_value(data), "a mapping", hint))
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as error:
        items = _join_unions(located.data, path, [*_join_arities(error.errors())])
        problems = [_to_problem(model, located, path, item) for item in items]
        raise DefinitionError(list(dict.fromkeys(problems))) from error  # one behind '<<' is met at each copy


def salvage(model: type[ModelT], located: Located, path: Address = ()) -> tuple[ModelT | None, list[Problem]]:
    """As `validate`, but without the offending values, so that the rest of the file can be checked too.

    A misspelt key stands in for the needed one that it resembles.

    Returns:
        The model, None when it cannot be built without them; and every problem.
    """
    problems: list[Problem] = []
    data = located.data
    for _ in range(SALVAGE_ROUNDS):
        try:
            return validate(model, replace(located, data=data), path), problems
        except KeyError:  # the value at the path is gone as a whole
            break
        except DefinitionError as error:
            cause = error.__cause__
            data = data if problems else copy.deepcopy(data)
            problems = problems or list(error.problems)
        if not isinstance(cause, pydantic.ValidationError):
            break
        errors = list(_join_arities(cause.errors()))
        renamed = {loc for item in errors if item["type"] == "missing" for loc in _rename(data, path, item, errors)}
        wrong = (  # without a key that it needs, a value goes as a whole
            (*path, *(item["loc"][:-1] if item["type"] == "missing" else item["loc"]))
            for item in errors
            if item["loc"] not in renamed
        )
        for owner, key in [_find_owner(data, each) for each in wrong]:  # all found before the first is removed
            owner.pop(key, None)
    return None, problems


def _rename(data: Any, path: Address, missing: Any, errors: Sequence[Any]) -> tuple[Address, ...]:
    """Give an unknown key the name of the missing one that it resembles; the paths that this settles."""
    *owner, key = missing["loc"]
    unknown = [
        item["loc"][-1] for item in errors if item["type"] == "extra_forbidden" and item["loc"][:-1] == (*owner,)
    ]
    nearest = find_nearest(key, unknown)
    for step in (*path, *owner):
        data = data[step] if isinstance(data, list) else data.get(step, data)
    if nearest is None or nearest not in data:
        return ()
    data[key] = data.pop(nearest)
    return (*owner, key), (*owner, nearest)


def _find_owner(data: Any, path: Address) -> tuple[_Mapping, str | int]:
    """The innermost mapping on the way to a value, and its key that leads there; an empty one where there is none."""
    owner: _Mapping = {}
    key: str | int = ""
    for step in _strip_tags(data, path):
        owner, key = (data, step) if isinstance(data, dict) else (owner, key)
        data = data[step]
    return owner, key


def misfit(key: str, expected: str, hint: str = "") -> PydanticCustomError:
    """What a validator of a model raises about the value of a key, dotted where it is deeper, to stand there."""
    return PydanticCustomError("misfit", "{wanted}", {"key": key, "wanted": expected, "hint": hint})


def _check_rising(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise misfit("", "the least value first, then the greatest", f"Write [{span[1]:g}, {span[0]:g}].")
    return span


def _check_corners(box: Corners) -> Corners:
    if advice := advise_corners(box):
        raise misfit("", "two corners, the least first", advice)
    return box


def advise_corners(box: Corners) -> str:
    """What to write for a box that does not begin with its least corner; empty where it does."""
    least, greatest = (list(map(of, *box)) for of in (min, max))
    return "" if all(map(operator.lt, *box)) else f"Write [{show_value(least)}, {show_value(greatest)}], of some size."


def _check_direction(values: _Values) -> _Values:
    if not any(values):
        raise misfit("", "a direction, which is not zero in every part", "Write 1 or -1 for one of them.")
    return values


def admit(text: str, check: Callable[[str], object]) -> str:
    """The text, in a validator of a model, unless `check` raises DefinitionError, whose first problem stands there."""
    try:
        check(text)
    except DefinitionError as error:
        raise PydanticCustomError("problem", "unsound", {"problem": error.problems[0]}) from error
    return text


Span = Annotated[tuple[float, float], pydantic.AfterValidator(_check_rising)]
"""Least and greatest value."""
Box = Annotated[Corners, pydantic.AfterValidator(_check_corners)]
"""Least and greatest corner."""
Direction = Annotated[tuple[float, float, float], pydantic.AfterValidator(_check_direction)]
Quaternion = Annotated[tuple[float, float, float, float], pydantic.AfterValidator(_check_direction)]
Positive = Annotated[float, pydantic.Field(gt=0.0)]
NotNegative = Annotated[float, pydantic.Field(ge=0.0)]


def _join_unions(data: Any, base: Address, errors: Sequence[ErrorDetails]) -> Iterator[ErrorDetails]:
    """The same errors; of a value of two possible forms, those of the form that it has, else of the first."""
    paths = [_strip_tags(data, (*base, *item["loc"])) for item in errors]
    for index, (item, path) in enumerate(zip(errors, paths, strict=True)):
        others = [each for i, each in enumerate(paths) if each[: len(path)] == path and (each != path or i < index)]
        if item["type"] not in _CONTAINERS or not others:
            yield item


def _join_arities(errors: Sequence[Any]) -> Iterator[Any]:
    """The same errors; a tuple that is too short is one, as is one that is too long."""
    for item in errors:
        *owner, last = item["loc"] or ("",)
        if item["type"] == "too_short" and len(item["input"]) >= item["ctx"]["min_length"]:
            continue  # its values are wrong, which is reported at each of them
        if item["type"] != "missing" or not isinstance(last, int):
            yield item
        elif last == len(item["input"]):  # the first value that is missing
            wanted = 1 + max(each["loc"][-1] for each in errors if each["loc"][:-1] == (*owner,))
            facts = {"max_length": wanted, "actual_length": last}
            yield {**item, "type": "too_long", "loc": (*owner,), "ctx": facts}


def _to_problem(model: type[Authored], located: Located, base: Address, item: ErrorDetails) -> Problem:
    loc, kind, facts, found = item["loc"], item["type"], item.get("ctx", {}), item.get("input")
    path = _strip_tags(located.data, (*base, *loc))
    key = str(loc[-1]) if loc else ""
    if kind == "extra_forbidden":
        fields = _find_fields(model, loc[:-1])
        problem = located.unknown("key", path, key, fields)
        called = [name for name, field in fields.items() if any(key in each.names for each in _iter_synonyms(field))]
        deeper = "" if format_hint(key, fields) else _find_deeper(fields, key)
        hint = f"It belongs below {deeper!r}." if deeper else problem.hint
        return msgspec.structs.replace(problem, hint=f"Here it is called {called[0]!r}." if called else hint)
    if kind == "missing":
        return located.problem("MISSING_VALUE", path, "nothing", f"key {key!r}", f"Add {key!r}.")
    if kind == "problem":
        unsound: Problem = facts["problem"]
        return msgspec.structs.replace(unsound, address=located.address_of(path))
    if kind == "misfit":
        for step in facts["key"].split(".") if facts["key"] else ():
            path, found = (*path, step), found.get(step)
        return located.problem("INVALID_VALUE", path, show_value(found), facts["wanted"], facts["hint"])
    if kind in {"union_tag_invalid", "union_tag_not_found"}:
        tag = facts["discriminator"].strip("'")
        if kind == "union_tag_not_found":
            return located.problem("MISSING_VALUE", path, "nothing", f"key {tag!r}", f"Add {tag!r}.")
        path, found, facts = (*path, tag), facts["tag"], {"expected": _ENUM.sub(r"\1", facts["expected_tags"])}
    expected = str(facts.get("expected") or phrase(kind, facts))
    names = expected.replace("'", "").replace(" or ", ", ").split(", ")
    hint = advise_form(found, _FORMS.get(kind.partition("_")[0], ""))
    hint = hint or (format_hint(found, names) if isinstance(found, str) else "")
    key = next((step for step in reversed(loc) if isinstance(step, str)), "")  # of a list, that of its owner
    hint = hint or _advise_numbers(model, loc, kind, found) or _advise(kind, key, facts, found)
    if not hint and "expected" in facts:
        hint = f"Write {names[0]}." if len(names) == 1 else "Write one of these."
    return located.problem("INVALID_VALUE", path, show_value(found), expected, hint)


def _strip_tags(data: Any, path: Address) -> Address:
    """The steps of a path that are in the data; pydantic adds the tags of unions, and keys that are missing."""
    kept: list[str | int] = []
    for step in path:
        if step in (data if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ()):
            kept.append(step)
            data = data[step]
    return tuple(kept)


_ENUM = re.compile(r"<[^<>]*: ('[^']*')>")  # a member as Python shows it
_PHRASES = {  # by pydantic's kind of error; its own sentences are written for programmers
    "greater_than": "a number greater than {gt}",
    "greater_than_equal": "a number of at least {ge}",
    "less_than": "a number less than {lt}",
    "less_than_equal": "a number of at most {le}",
    "finite_number": "a finite number",
    "float": "a number",
    "int": "a whole number",
    "int_from_float": "a whole number",
    "bool": "true or false",
    "string": "a text",
    "string_pattern_mismatch": "a text that matches {pattern}",
    "too_short": "at least {min_length} of them",
    "too_long": "{max_length} values",
    "tuple": "a list",
    "list": "a list",
    "dict": "a mapping",
    "model": "a mapping",
    "value_error": "{error}",
}


_FORMS = {
    "float": "number",
    "int": "integer",
    "bool": "boolean",
    "string": "string",
}  # pydantic's names: those of ports


_PATTERNS = {
    r"^[a-z][a-z0-9_]*$": "small letters, digits and '_', with a letter first",
    r"^[a-z][a-z0-9_/]*$": "small letters, digits, '_' and '/', with a letter first",
    r"^[a-z0-9][a-z0-9_]*$": "small letters, digits and '_'",
    r"^https?://\S+$": "an address that begins with http:// or https://",
}


def phrase(kind: str, facts: Mapping[str, Any]) -> str:
    """What is expected where a value is of the wrong kind, by pydantic's name of the error."""
    if facts.get("pattern") in _PATTERNS:
        return _PATTERNS[facts["pattern"]]
    kind = kind.removesuffix("_type").removesuffix("_parsing")
    return _PHRASES.get(kind, f"another value ({kind.replace('_', ' ')})").format_map(facts)


_UNITS = frozenset({"m", "kg", "s", "rad", "deg", "hz", "n", "nm", "px"})  # at the end of a key


_NUMBER = re.compile(r"[-+]?[0-9]*\.?[0-9]+(e[-+]?[0-9]+)?$")
_CONTAINERS = frozenset({"list_type", "tuple_type", "dict_type", "model_type"})
_STEPS = {  # by pydantic's kind of error
    "greater_than": "Write more than {gt:g}.",
    "greater_than_equal": "Write {ge:g} or more.",
    "less_than": "Write less than {lt:g}.",
    "less_than_equal": "Write {le:g} or less.",
    "finite_number": "Write a number such as 1.0, or leave the key out.",
    "list_type": "Write [{found}].",
    "tuple_type": "Write [{found}].",
    "dict_type": "Write 'key: value' below it.",
    "model_type": "Write 'key: value' below it.",
    "string_type": "Write a text, or leave the key out.",
    "bool_type": "Write true or false.",
    "too_short": "Add one, or leave the key out.",
}


def _advise_numbers(model: type[Authored], loc: Address, kind: str, found: object) -> str:
    """What to write for a word where a list of numbers is expected; else empty."""
    if kind not in {"tuple_type", "list_type"} or not isinstance(found, str) or found[:1].isdigit():
        return ""
    owners: list[object] = [model]
    for step in loc:
        owners = [inner for each in owners for inner in _enter(each, step)]
    numbers = next(
        (each for each in owners if {float, int} & {getattr(of, "__origin__", of) for of in _enter(each, 0)}), None
    )
    length = len([each for each in get_args(numbers) if each is not Ellipsis])
    return f"Write numbers: [{', '.join('1' * length)}{', …' if length == 1 else ''}]." if numbers is not None else ""


def _advise(kind: str, key: str, facts: Mapping[str, Any], found: object) -> str:
    """What to do about a value of the wrong form; empty where what is expected says it."""
    if kind == "too_long":
        more = facts["max_length"] - facts["actual_length"]
        return f"Add {more}." if more > 0 else f"Remove {-more}."
    *_, of, unit = ("", *key.split("_"))
    pieces = found.replace(",", " ").split() if isinstance(found, str) else []
    if kind in {"list_type", "tuple_type"} and len(pieces) > 1 and all(map(_NUMBER.match, pieces)):
        return f"Write [{', '.join(pieces)}]."
    if kind in {"list_type", "tuple_type"} and isinstance(found, str) and found[:1] in BULLETS:
        return "Begin each item of a list with '- '."
    if of and unit in _UNITS and isinstance(found, str):
        return f"{key!r} is in {f'{of}/{unit}' if of in _UNITS else unit}; write the number alone."
    if kind == "string_pattern_mismatch":
        return suggest_name(str(found), facts["pattern"])
    if kind == "string_type" and isinstance(found, list) and len(found) == 1:
        return f"Write {show_value(found[0])}, without brackets."
    if kind in _STEPS and (found is not None or kind == "string_type"):
        shown = (
            f'"{found}"' if isinstance(found, str) else "…" if isinstance(found, dict) else f"{show_value(found)}, …"
        )
        return _STEPS[kind].format_map({**facts, "found": shown})
    if found is None and kind in _STEPS:
        return "Write a value, or leave the key out."
    return "Write a number such as 1." if kind.partition("_")[0] in {"int", "float"} else ""


def suggest_name(name: str, pattern: str) -> str:
    """What to write for a name with capitals or blanks; empty where that is no name either."""
    snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|[^A-Za-z0-9_/]+", "_", name).strip("_/").lower()
    return f"Write {snake!r}." if re.match(pattern, snake) else ""


def show_value(value: object) -> str:
    """A value as it stands in a file; only the kind of what is long or nested."""
    if isinstance(value, list | tuple) and len(value) <= SHOWN and not any(isinstance(each, dict) for each in value):
        return f"[{', '.join(map(show_value, value))}]"
    if isinstance(value, list | tuple | dict):
        return "{}" if value == {} else "a mapping" if isinstance(value, dict) else "a list"
    return format_scalar(value)


def _iter_synonyms(field: pydantic.fields.FieldInfo) -> Iterator[AlsoCalled]:
    return (each for each in field.metadata if isinstance(each, AlsoCalled))


def _find_fields(model: type[Authored], loc: Address) -> dict[str, pydantic.fields.FieldInfo]:
    """What is possible inside `model` at the place `loc`; empty when the place is free-form."""
    found: list[Any] = [model]
    for step in loc:
        found = [inner for each in found for inner in _enter(each, step)]
    models = [inner for each in found for inner in _iter_models(each)]
    return {info.alias or name: info for name, info in models[0].model_fields.items()} if models else {}


def _find_deeper(fields: Mapping[str, pydantic.fields.FieldInfo], key: str) -> str:
    """Which of these fields holds models with that key; `NAME` stands for a key of a mapping."""
    for name, info in fields.items():
        if any(key in each.model_fields for each in _iter_models(info.annotation)):
            return f"{name}.NAME" if get_origin(info.annotation) is dict else name
    return ""


def _enter(annotation: object, step: str | int) -> Sequence[object]:
    """Annotations of the value at one step of pydantic's paths; the tag of a union leads to the model itself."""
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        fields = annotation.model_fields
        inner = [info.annotation for name, info in fields.items() if step in (name, info.alias)]
        is_tag = step == annotation.__name__ or any(step in get_args(info.annotation) for info in fields.values())
        return inner or ([annotation] if is_tag else [])
    if get_origin(annotation) in {dict, tuple, list}:
        return [get_args(annotation)[1 if get_origin(annotation) is dict else 0]]
    return [inner for each in get_args(annotation) for inner in _enter(each, step)]


def _iter_models(annotation: Any) -> Iterator[type[pydantic.BaseModel]]:
    """The models inside an annotation such as `Texture | None`."""
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        yield annotation
    for each in get_args(annotation):
        yield from _iter_models(each)
