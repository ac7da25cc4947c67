"""Plain data: what YAML and JSON hold before its form is checked."""

import math
from typing import Any, TypeAlias

import msgspec

Fields: TypeAlias = dict[str, Any]
"""Values by key; their form is checked where they are read."""


def to_plain(value: object) -> Any:
    """What a person's code measured as plain data: numbers and arrays of NumPy as Python's; raises TypeError."""
    return msgspec.to_builtins(value, enc_hook=_unpack, str_keys=True)


def to_numbers(values: object) -> dict[str, float | str | bool]:
    """Finite numbers and texts by name, as `to_plain`; raises TypeError or ValueError."""
    measured = msgspec.convert(to_plain(values), dict[str, float | int | str | bool])
    if strange := [name for name, value in measured.items() if isinstance(value, float) and not math.isfinite(value)]:
        raise ValueError(f"{', '.join(strange)} is not finite")
    return measured


def _unpack(value: object) -> object:
    if callable(unpack := getattr(value, "tolist", None)):
        return unpack()
    raise TypeError(f"{value!r:.80} is no plain data")
