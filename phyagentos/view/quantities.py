"""Quantities as people read them: `side_x_m` is "side x", -0.228 of it are "−228 mm"."""

import math
import re

from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.wording import format_angle, format_length

_UNITS = {"_m": (1e3, 0, "mm"), "_rad": (math.degrees(1), 1, "°"), "_s": (1.0, 2, "s"), "_n": (1.0, 1, "N")}
_SAID = {"_m": format_length, "_rad": format_angle}  # as sentences of judges have them


def find_unit(name: str) -> str:
    """The end of a quantity's name that is its unit, as far as it is known."""
    return next((unit for unit in _UNITS if name.endswith(unit)), "")


def name_quantity(name: str) -> str:
    """A quantity's name without its unit."""
    return name.removesuffix(find_unit(name)).replace("_", " ")


def format_measure(value: object, name: str) -> str:
    """A quantity in the unit in which people read it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, int | float):
        return str(value)
    factor, digits, unit = _UNITS.get(find_unit(name), (1.0, 3, ""))
    number = f"{factor * value:.{digits}f} {unit}" if unit else f"{round(value, digits):g}"
    return number.replace("-", "−")


def list_numbers(measured: dict[str, float | str | bool]) -> dict[str, float]:
    """The numbers among what was measured; those with a unit alone where there are any."""
    numbers = {name: float(each) for name, each in measured.items() if type(each) in {int, float}}
    return {name: each for name, each in numbers.items() if find_unit(name)} or numbers


def find_deciding(criterion: Criterion) -> str:
    """Which quantity decided: the one that the judge's sentence says, else the least; empty where none was measured."""
    numbers = list_numbers(criterion.measured)
    said = {name: _SAID[unit](each) for name, each in numbers.items() if (unit := find_unit(name)) in _SAID}
    in_words = [name for name, text in said.items() if re.search(rf"(?<!\S){text}(?!\w)", criterion.because)]
    return min(in_words or numbers, key=numbers.__getitem__, default="")
