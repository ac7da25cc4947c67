"""YAML in, frozen models out: every problem at once, each with file, line and column.

Untyped data (`Any`) enters the project only here. Models are pydantic classes derived from `Authored`, so unknown keys
are refused and the JSON Schema for editors comes from the same source.
"""

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import yaml

from phyagentos.errors import DefinitionError, Problem, find_nearest, format_hint
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.documents.yaml_bounds import DEPTH_MAX, TOO_DEEP, VALUES_MAX, check_bounds, refuse

Loader: type[yaml.SafeLoader] = type("Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})
NUMBER_LETTERS_MAX = 400  # of a number, date or truth value; a million letters would be worked on for hours
Address = tuple[str | int, ...]
ModelT = TypeVar("ModelT", bound="Authored")
SALVAGE_ROUNDS = 4  # dropping a value may make its owner incomplete, and so on up


class Authored(pydantic.BaseModel):
    """Base of every model that a person writes: frozen, no unknown keys."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", populate_by_name=True, allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class Located:
    """A YAML value; `marks` gives (line, column) of each path in it, counted from 1, of the key for mapping values.

    `origins` gives the values that come from elsewhere: where each one stands there.
    """

    data: Any
    source: str
    marks: Mapping[Address, tuple[int, int]] = field(default_factory=dict)
    origins: dict[Address, tuple["Located", Address]] = field(default_factory=dict)

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

    def unknown(self, code: str, path: Address, name: str, possible: Iterable[str], found: str = "") -> Problem:
        """A `Problem.unknown` at this place."""
        return Problem.unknown(code, self.address_of(path), name, possible, found)


def read_text(path: Path, hint: str = "Check the path and its encoding.") -> str:
    """Read a text file that a person may have written; raises DefinitionError unless it is regular, small and UTF-8."""
    try:
        return read_regular(path).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise DefinitionError.of("UNREADABLE_FILE", str(path), str(error), hint=hint) from error


def read_yaml(path: Path) -> Located:
    """Read one YAML file; see `parse_yaml`."""
    return parse_yaml(read_text(path), str(path))


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
        place = f"{source}:{mark.line + 1 + offset}:{mark.column + 1}" if mark else source
        detail = getattr(error, "problem", None) or str(error)
        if isinstance(error, yaml.scanner.ScannerError) and mark:  # newer ones have a limit too, and words of their own
            count = text[: mark.index].count
            detail = TOO_DEEP if count("[") + count("{") - count("]") - count("}") > DEPTH_MAX else detail
        raise DefinitionError.of("YAML_SYNTAX", place, str(detail)) from error
    if problems:
        raise DefinitionError(problems)
    return Located(data=data, source=source, marks=marks)


def _report_failure(construct: Callable[[Any, Any], Any], kind: str) -> Callable[[Any, Any], Any]:
    """As `construct`; a scalar that fails to parse is reported like any other error, with its place."""

    def construct_or_report(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> Any:
        try:
            value = construct(loader, node) if len(node.value) <= NUMBER_LETTERS_MAX else 2**64
            if not isinstance(value, int) or -(2**63) <= value < 2**64:  # more the journal does not take
                return value
        except (ArithmeticError, AttributeError, LookupError, ValueError):
            pass
        problem = f"{node.value[:40]!r} is no {kind}; quote it where it is text"
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)

    return construct_or_report


for _tag, _kind in {"bool": "truth value", "float": "number", "int": "integer of 64 bits", "timestamp": "date"}.items():
    _construct = yaml.SafeLoader.yaml_constructors[f"tag:yaml.org,2002:{_tag}"]
    Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _report_failure(_construct, _kind))


def _collect_marks(
    node: yaml.Node,
    path: Address,
    source: str,
    offset: int,
    marks: dict[Address, tuple[int, int]],
    problems: list[Problem],
) -> None:
    if len(path) > DEPTH_MAX:
        raise refuse(TOO_DEEP, node.start_mark)
    marks.setdefault(path, (node.start_mark.line + 1 + offset, node.start_mark.column + 1))
    if isinstance(node, yaml.SequenceNode):
        for index, child in enumerate(node.value):
            _collect_marks(child, (*path, index), source, offset, marks, problems)
    elif isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, child in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue  # refused when it is constructed
            line, column = key.start_mark.line + 1 + offset, key.start_mark.column + 1
            if key.value in seen:
                problems.append(Problem("DUPLICATE_KEY", f"{source}:{line}:{column}", repr(key.value)))
            seen.add(key.value)
            marks[(*path, key.value)] = (line, column)
            _collect_marks(child, (*path, key.value), source, offset, marks, problems)


def validate(model: type[ModelT], located: Located, path: Address = ()) -> ModelT:
    """The frozen model of located YAML data at `path`; raises DefinitionError, each violation at file:line:column."""
    data = located.data
    for step in path:
        data = data[step]
    if not isinstance(data, dict):
        raise DefinitionError(located.problem("WRONG_TYPE", path, type(data).__name__, f"a mapping ({model.__name__})"))
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as error:
        raise DefinitionError([_to_problem(model, located, path, item) for item in error.errors()]) from error


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
        except DefinitionError as error:
            cause = error.__cause__
            data = data if problems else copy.deepcopy(data)
            problems = problems or list(error.problems)
        if not isinstance(cause, pydantic.ValidationError):
            break
        errors = cause.errors()
        renamed = {loc for item in errors if item["type"] == "missing" for loc in _rename(data, path, item, errors)}
        for item in errors:  # without a key that it needs, a value goes as a whole
            if item["loc"] not in renamed:
                _drop(data, (*path, *(item["loc"][:-1] if item["type"] == "missing" else item["loc"])))
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


def _drop(data: Any, path: Address) -> None:
    """Remove the value at a path; steps that are not in the data (tags of a union) are passed over."""
    owner: dict[Any, Any] | None = None
    key: str | int = ""
    for step in path:
        if isinstance(data, dict) and step in data:
            owner, key, data = data, step, data[step]
        elif isinstance(data, list) and isinstance(step, int) and step < len(data):
            data = data[step]
    if owner is not None:
        owner.pop(key, None)


def _to_problem(model: type[Authored], located: Located, base: Address, item: Any) -> Problem:
    path = (*base, *item["loc"])
    kind = item["type"]
    key = str(item["loc"][-1]) if item["loc"] else ""
    if kind == "extra_forbidden":
        return located.unknown("UNKNOWN_KEY", path, key, find_fields(model, item["loc"][:-1]))
    if kind == "missing":
        return located.problem("MISSING_KEY", path[:-1], "nothing", f"key {key!r}", f"Add {key!r}.")
    found = item.get("input")
    shown = repr(found) if isinstance(found, str | int | float | bool) or found is None else type(found).__name__
    expected = item.get("ctx", {}).get("expected") or item["msg"]
    hint = (
        format_hint(found, str(expected).replace("'", "").replace(" or ", ", ").split(", "))
        if isinstance(found, str)
        else ""
    )
    return located.problem("INVALID_VALUE", path, shown, str(expected), hint)


def find_fields(model: type[Authored], loc: tuple[Any, ...]) -> list[str]:
    """Names that are possible inside `model` at the place `loc`; empty when the place is free-form."""
    current: Any = model
    for step in loc:
        if not (isinstance(current, type) and issubclass(current, pydantic.BaseModel)):
            current = _find_model(current, step)
            continue
        info = next((f for n, f in current.model_fields.items() if step in (n, f.alias)), None)
        current = info.annotation if info is not None else None
    if not (isinstance(current, type) and issubclass(current, pydantic.BaseModel)):
        current = _find_model(current, "")
    if current is None:
        return []
    return [info.alias or name for name, info in current.model_fields.items()]


def _find_model(annotation: Any, step: Any) -> Any:
    """The model class inside an annotation such as `dict[str, Node] | None` (or the one a union tag names)."""
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return annotation
    candidates = [found for arg in getattr(annotation, "__args__", ()) if (found := _find_model(arg, step)) is not None]
    return next((each for each in candidates if each.__name__ == step), candidates[0] if candidates else None)
