"""Ports of leaves: a type, and for a number the range that it has to be in."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from py_trees.ports import PortInformation


@dataclass(frozen=True)
class Port(PortInformation):
    """One input or output; ends of a range are in the unit of the port, `choices` are the only texts.

    Attributes:
        minimum: Least number.
        above: Number that it has to be greater than.
        maximum: Greatest number.
        choices: The only texts; any without.
    """

    minimum: float = -math.inf
    above: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()


def expand_ports(ports: Mapping[str, PortInformation], given: Iterable[str]) -> Mapping[str, PortInformation]:
    """The ports, and the given fields, of any type, of those that are mappings."""
    whole = {path: ports.get(path.partition(".")[0]) for path in given}
    fields = {path: _FIELD for path, port in whole.items() if port is not None and port.data_type is dict}
    return {**fields, **ports}


_FIELD = PortInformation(data_type=object, required=False)


def find_misfit(value: object, port: PortInformation) -> str:
    """What a value of the port's type should have been; empty where every number in it is finite and in range."""
    numbers = [*_iter_numbers(value)]
    if not all(map(math.isfinite, numbers)):
        return "a finite number" if numbers == [value] else "finite numbers"
    if isinstance(port, Port) and port.choices and value not in port.choices:
        return " or ".join(map(repr, port.choices))
    if not isinstance(port, Port) or all(port.minimum <= n <= port.maximum and n > port.above for n in numbers):
        return ""
    words = {"of at least": port.minimum, "greater than": port.above, "of at most": port.maximum}
    ends = " and ".join(f"{word} {end:g}" for word, end in words.items() if math.isfinite(end))
    return f"a number {ends}"


def _iter_numbers(value: object) -> Iterator[float]:
    if isinstance(value, list | tuple):
        for each in value:
            yield from _iter_numbers(each)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value
