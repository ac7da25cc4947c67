"""Markdown with embedded YAML: the form of every protocol document.

A document is prose for people; what programs read is its YAML front matter and its fenced `yaml` blocks. A fence may be
named by the heading above it.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from phyagentos.errors import DefinitionError, Problem

_FRONT = re.compile(r"\A---\n(.*?\n)---\n", re.DOTALL)
_BLOCK = re.compile(r"^## (?P<name>\S[^\n]*)\n(?P<prose>.*?)^```yaml\n(?P<yaml>.*?)^```\n", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Block:
    """One `## name` heading with its fenced YAML.

    Attributes:
        name: The heading's text.
        yaml: The text between the fences.
        line: Line of the file on which the YAML begins, counted from 1.
    """

    name: str
    yaml: str
    line: int


def split_front_matter(text: str, source: str) -> tuple[str, int]:
    """The YAML between the first two `---` lines, and the line it begins on.

    Raises:
        DefinitionError: When the text does not begin with front matter.
    """
    match = _FRONT.match(text)
    if match is None:
        raise DefinitionError(
            Problem(
                code="FRONT_MATTER_MISSING",
                address=f"{source}:1:1",
                found=repr(text.split("\n", 1)[0][:40]),
                expected="a first line '---', YAML, and a line '---'",
            )
        )
    return match[1], 2


def iter_blocks(text: str) -> Iterator[Block]:
    """Every `## name` section that holds a fenced YAML block, in order."""
    for match in _BLOCK.finditer(text):
        yield Block(match["name"].strip(), match["yaml"], text.count("\n", 0, match.start("yaml")) + 1)
