"""Scalars of every authored file, read as YAML 1.2 reads numbers; what only YAML 1.1 means by them is a problem.

PyYAML takes `060` for 48, `1:30` for 90, `1_000` for 1000 and `5e-1` for a text. Here a number has decimal digits, a
point and an exponent as in JSON, or is `0x1f`, `.inf` or `.nan`; other forms are named with what to write. `yes`, `no`,
`on` and `off` are truth values as values, and words as keys. Writers quote a text that this reads as a number.
"""

import datetime
import math
import re
from collections.abc import Callable
from typing import Any

import yaml

Loader: type[yaml.SafeLoader] = type("Loader", (getattr(yaml, "CSafeLoader", yaml.SafeLoader),), {})
NUMBER_LETTERS_MAX = 400  # of a number, date or truth value; a million letters would be worked on for hours
SHOWN_MAX = 40  # letters of a scalar that a message shows
_TAG = "tag:yaml.org,2002:"
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)[eE][-+]?[0-9]+$")  # 1.1 wants a point and a sign in it
_OLD_FORMS = {
    re.compile(r"[-+]?0[0-7_]+$"): "which YAML 1.1 reads as octal",
    re.compile(r"[-+]?[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?$"): "which YAML 1.1 reads in base 60",
    re.compile(r"[-+]?0b[01_]+$"): "which YAML 1.1 reads as binary",
    re.compile(r".*_"): "which has _ between its digits",
}
_KEY_KINDS = {"bool": "a truth value", "float": "a number", "int": "a number", "null": "nothing", "timestamp": "a date"}

_DUMPERS = {yaml.SafeDumper, getattr(yaml, "CSafeDumper", yaml.SafeDumper)}
for _class in (Loader, *_DUMPERS):
    _class.add_implicit_resolver(f"{_TAG}float", _FLOAT, list("-+.0123456789"))


_resolve: Callable[..., str] = Loader("").resolve


def _report_failure(construct: Callable[[Any, Any], Any], kind: str) -> Callable[[Any, Any], Any]:
    """As `construct`; a scalar that fails to parse is reported like any other error, with its place."""

    def construct_or_report(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> Any:
        try:
            value = construct(loader, node) if len(node.value) <= NUMBER_LETTERS_MAX else 2**64
            is_infinite = isinstance(value, float) and math.isinf(value) and "inf" not in node.value.lower()
            if not is_infinite and (not isinstance(value, int) or -(2**63) <= value < 2**64):  # as the journal takes
                return value
        except (ArithmeticError, AttributeError, LookupError, ValueError):
            pass
        problem = f"{node.value[:SHOWN_MAX]!r}, which is no {kind}; quote it where it is text"
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)

    return construct_or_report


for _kind, _name in {
    "bool": "truth value",
    "float": "number",
    "int": "integer of 64 bits",
    "timestamp": "date",
}.items():
    Loader.add_constructor(
        f"{_TAG}{_kind}", _report_failure(yaml.SafeLoader.yaml_constructors[f"{_TAG}{_kind}"], _name)
    )


def find_old_number(node: yaml.ScalarNode) -> tuple[str, str, str] | None:
    """Found, expected and hint of a plain scalar that is a number in YAML 1.1 alone; None for every other."""
    if node.style or node.tag not in (f"{_TAG}int", f"{_TAG}float") or len(node.value) > NUMBER_LETTERS_MAX:
        return None
    meaning = next((why for form, why in _OLD_FORMS.items() if form.match(node.value)), "")
    if not meaning:
        return None
    digits = node.value.replace("_", "")
    decimal = re.sub(r"^([-+]?)0+(?=\d)", r"\1", digits) if digits.lstrip("-+").isdigit() else ""
    sexagesimal = f"{yaml.SafeLoader('').construct_yaml_float(node):g}" if ":" in digits else ""
    quoted = f"'{node.value[:SHOWN_MAX]}'"
    hint = f"Write {decimal or sexagesimal or 'the number itself'}, or {quoted} in quotes where it is text."
    return f"{node.value[:SHOWN_MAX]}, {meaning}", "decimal digits", hint


def find_key_kind(key: yaml.ScalarNode) -> str:
    """What a key is that is no text; empty for a text. `yes`, `no`, `on` and `off` become words, as in YAML 1.2."""
    kind = _KEY_KINDS.get(key.tag.removeprefix(_TAG), "")
    if kind == _KEY_KINDS["bool"] and not key.style and key.value.lower() not in {"true", "false"}:
        key.tag = f"{_TAG}str"
        return ""
    return kind


def format_scalar(value: object) -> str:
    """A value as a file has it: `.nan`, `true`, and text in quotes."""
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else f"{'-' * (value < 0)}.inf"
    if isinstance(value, datetime.date):
        return value.isoformat()
    return str(value).lower() if isinstance(value, bool) else "nothing" if value is None else repr(value)


def advise_form(found: object, wanted: str) -> str:
    """What to write instead of a value of another form (`wanted` is number, integer, boolean or string), else empty."""
    if isinstance(found, bool):
        unquoted = "YAML reads yes, no, on and off as true and false"
        return f"{unquoted}; write a number." if wanted in {"number", "integer"} else f"{unquoted}; quote a text."
    if isinstance(found, int | float):
        if wanted == "integer" and math.isfinite(found):
            return f"Write {math.floor(found)}{'' if found == math.floor(found) else f' or {math.ceil(found)}'}."
        return f"Write '{found}' in quotes." if wanted == "string" else ""
    if wanted == "number" and isinstance(found, str) and re.fullmatch(r"\d{1,9}(\.\d{1,9})? ?%", found):
        return f"Write {float(found.rstrip(' %')) / 100:g}."
    kind = _resolve(yaml.ScalarNode, found, (True, False)) if isinstance(found, str) and found else ""
    kinds = {"boolean": ("bool",), "number": ("int", "float"), "integer": ("int",)}.get(wanted, ())
    is_old = isinstance(found, str) and re.fullmatch(r"[-+]?0\d+", found) and "int" in kinds
    if is_old or kind.removeprefix(_TAG) in kinds:
        return f"Write {str(found).lstrip('0') or '0' if is_old else found} without quotes."
    return ""
