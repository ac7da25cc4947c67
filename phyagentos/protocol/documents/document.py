"""Markdown with embedded YAML: the form of every protocol document.

Programs read the YAML front matter and the fenced `yaml` blocks, each named by the `##` heading above it. As data, a
document is its front matter with one more key, `blocks`: heading -> block; its JSON Schema describes that.
"""

import re
from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import msgspec

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.documents.plain_data import Fields

if TYPE_CHECKING:
    from phyagentos.protocol.documents.schema import Located

BLOCKS = "blocks"
_FRONT = re.compile(r"\A---\n(.*?\n)---\n", re.DOTALL)
_FENCE = re.compile(r"(?P<ticks>`{3,}|~{3,})(?P<language>[^`\n]*)")
BlockT = TypeVar("BlockT")


@dataclass(frozen=True, slots=True)
class Block:
    """One `## name` heading with its fenced YAML.

    Attributes:
        line: Line of the file on which the YAML begins, counted from 1.
    """

    name: str
    yaml: str
    line: int


class Front(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The front matter, between two lines `---` at the top.

    Attributes:
        phy: Kind and version of the document (`lessons/1`).
    """

    phy: str


class FrontMatter(Front, frozen=True, kw_only=True, omit_defaults=True):
    """The front matter of a view of the journal.

    Attributes:
        view: Sequence number of the last journal record that it shows.
    """

    view: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentFormat(Generic[BlockT]):
    """How one kind of document is written.

    Attributes:
        name: Its kind; also the name of its schema and of its page (`sessions`).
        file: Its name in a workspace (`SESSIONS.md`).
        block: What each block holds: a struct, or an authored model; None when it has no block.
        headings: The only headings that carry a block; any where empty.
        key: Field of the block that repeats the heading, empty when none does.
        lines: What each line is, for a document that consists of lines; None for every other.
    """

    name: str
    file: str
    summary: str
    block: type[BlockT] | None
    headings: tuple[str, ...] = ()
    key: str = ""
    front: type[Front] = Front
    lines: type[msgspec.Struct] | None = None

    @property
    def phy(self) -> str:
        """Kind and version, as in the front matter."""
        return f"{self.name}/1"


@dataclass(frozen=True, slots=True)
class Document(Generic[BlockT]):
    """The front matter and the blocks by heading."""

    front: Front
    blocks: dict[str, BlockT] = field(default_factory=dict)


def read_document(
    text: str, format: DocumentFormat[BlockT], source: str = "", *, passed_over: Container[str] = ()
) -> Document[BlockT]:
    """Read a document, without blocks below `passed_over`; raises DefinitionError, each problem at file:line:column."""
    source = source or format.file
    problems: list[Problem] = []
    front: Front | None = None
    blocks: dict[str, BlockT] = {}
    try:
        front = _read_front(text, format, source)
    except DefinitionError as error:
        problems += error.problems
    found, unclosed = _scan(text)
    if unclosed:
        problems.append(Problem("SYNTAX", f"{source}:{unclosed}:1", expected="a line '```' below"))
    for block in found:
        if block.name in passed_over:
            continue
        try:
            if block.name in blocks:
                address = f"{source}:{block.line}:1"
                raise DefinitionError.of("DUPLICATE_NAME", address, repr(block.name), "each heading once")
            blocks[block.name] = _read_block(block, format, source)
        except DefinitionError as error:
            problems += error.problems
    if problems or front is None:
        raise DefinitionError(problems)
    return Document(front, blocks)


def build_schema(format: DocumentFormat[Any]) -> Fields:
    """The JSON Schema of a document as data."""
    from phyagentos.protocol.documents.struct_schema import build_struct_schema

    _, definitions = build_struct_schema(format.front)
    front = definitions.pop(format.front.__name__)
    properties = front["properties"]
    properties["phy"] = {"const": format.phy, "description": "Kind and version of the document."}
    blocks: Fields = {"type": "object", "description": "By heading." if format.block else "None."}
    if format.block is None:
        blocks["maxProperties"] = 0
    else:
        schema, more = _build_block_schema(format.block)
        definitions |= more
        if format.headings:
            blocks |= {"properties": dict.fromkeys(format.headings, schema), "additionalProperties": False}
        else:
            blocks["additionalProperties"] = schema
    properties[BLOCKS] = blocks
    if format.lines is not None:
        line, more = build_struct_schema(format.lines)
        definitions |= more
        properties["lines"] = {"type": "array", "items": line, "description": "Oldest first."}
    return {
        "title": format.file,
        "description": format.summary,
        "type": "object",
        "properties": properties,
        "required": [*front["required"], BLOCKS],
        "additionalProperties": False,
        "$defs": definitions,
    }


def split_front_matter(text: str, source: str) -> tuple[str, int]:
    """The YAML between the first two `---` lines, and the line it begins on; raises DefinitionError without any."""
    match = _FRONT.match(text)
    if match is None:
        expected, first = "a first line '---', YAML, and a line '---'", text.split("\n", 1)[0]
        is_open = first.rstrip() == "---"
        hint = f"Write a {'second' if is_open else 'first'} line '---'."
        found = "a first line '---' alone" if is_open else repr(first[:40])
        raise DefinitionError.of("MISSING_VALUE", f"{source}:1:1", found, expected, hint)
    return match[1], 2


def iter_blocks(text: str) -> Iterator[Block]:
    """The first fenced YAML block below each `## name` heading, in order; what is fenced is no heading."""
    yield from _scan(text)[0]


def _scan(text: str) -> tuple[list[Block], int]:
    """Every block, and the line of an unclosed fence, 0 without one."""
    blocks: list[Block] = []
    name, fence, begin, opened = "", "", 0, 0
    lines = text.split("\n")
    for number, line in enumerate(lines):
        if fence:
            if line.rstrip().startswith(fence) and not line.rstrip().strip(fence[0]):
                if begin and name:
                    blocks.append(Block(name, "".join(f"{each}\n" for each in lines[begin:number]), begin + 1))
                    name = ""
                fence, begin = "", 0
        elif match := _FENCE.match(line):
            fence, opened = match["ticks"], number + 1
            begin = number + 1 if match["language"].strip() == "yaml" else 0
        elif line.startswith("## ") and line[3:].strip():
            name = line[3:].strip()
    return blocks, opened if fence else 0


def _read_front(text: str, format: DocumentFormat[Any], source: str) -> Front:
    from phyagentos.protocol.documents.schema import parse_yaml
    from phyagentos.protocol.documents.struct_schema import convert_located

    yaml, line = split_front_matter(text, source)
    located = parse_yaml(yaml, source, line)
    front = convert_located(format.front, located)
    if front.phy != format.phy:
        raise DefinitionError(located.problem("INVALID_VALUE", ("phy",), repr(front.phy), repr(format.phy)))
    return front


def _read_block(block: Block, format: DocumentFormat[BlockT], source: str) -> BlockT:
    from phyagentos.protocol.documents.schema import parse_yaml

    if format.block is None or (format.headings and block.name not in format.headings):
        hint = format_hint(block.name, format.headings)
        expected = format_names(format.headings) if format.headings else "no block of YAML"
        address = f"{source}:{block.line}:1"
        raise DefinitionError.of("UNKNOWN_NAME", address, repr(block.name), expected, hint, "block")
    located = parse_yaml(block.yaml, source, block.line)
    value = _convert(format.block, located)
    if format.key:
        name = attrgetter(format.key)(value)
        if name != block.name:
            path = tuple(format.key.split("."))
            raise DefinitionError(located.problem("INVALID_VALUE", path, repr(name), f"its heading {block.name!r}"))
    return value


def _convert(kind: type[BlockT], located: "Located") -> BlockT:
    from phyagentos.protocol.documents.schema import Authored, validate
    from phyagentos.protocol.documents.struct_schema import convert_located

    if issubclass(kind, Authored):
        return validate(kind, located)
    return convert_located(kind, located)


def _build_block_schema(kind: type) -> tuple[Fields, Fields]:
    from phyagentos.protocol.documents.schema import Authored
    from phyagentos.protocol.documents.struct_schema import build_authored_schema, build_struct_schema

    if not issubclass(kind, Authored):
        return build_struct_schema(kind)
    schema, definitions = build_authored_schema(kind)
    return {"$ref": f"#/$defs/{kind.__name__}"}, definitions | {kind.__name__: schema}
