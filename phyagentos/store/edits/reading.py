"""SESSIONS.md as an editor left it: head, sections, the words and the YAML of each.

Nothing here raises: what cannot be parsed stays in the text of its section, where the merge refuses it word for word.
"""

import re
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from phyagentos.store.views.sessions import END_MARK, NOTE_MARK

_VIEW = re.compile(r"^view:[ \t]*(\d{1,18})[ \t]*$", re.MULTILINE)
_FENCE = re.compile(r"(?P<ticks>`{3,}|~{3,})(?P<language>[^`]*)$")
_YAML_FENCE = re.compile(r"(`{3,}|~{3,})[ \t]*ya?ml[ \t]*$")
_FRONT = re.compile(r"\A---[ \t]*\n(.*?)^---[ \t]*\n", re.DOTALL | re.MULTILINE)
_FRONT_MAX = 4096
_LINE_THAT_MATTERS = re.compile(r"^(?:```|~~~|## ).*", re.MULTILINE)

Line = tuple[int, str]  # number, counted from 1, and text without trailing blanks


@dataclass(frozen=True)
class Section:
    """One `## name` (at `line`, counted from 1) and all text below it; parsed when first asked for."""

    name: str
    line: int
    text: str

    @cached_property
    def yaml(self) -> str | None:
        """Of its first fenced block, None where there is none or its fence is open."""
        opening, closing = self._fence
        lines = self._lines[opening + 1 : closing]
        return "".join(f"{line}\n" for line in lines) if opening else None

    @property
    def yaml_line(self) -> int:
        """On which that begins."""
        return self.line + (self._fence[0] + 1 if self._fence[0] else 0)

    @cached_property
    def prose(self) -> tuple[Line, ...]:
        """Every other line that is not blank."""
        opening, closing = self._fence
        end = len(self._lines)
        parts = [(1, opening), (closing + 1, end)] if opening else [(1, end)]
        return tuple(line for a, b in parts for line in _number(self._lines[a:b], self.line + a))

    @cached_property
    def _lines(self) -> list[str]:
        return self.text.split("\n")

    @cached_property
    def _fence(self) -> tuple[int, int]:
        """Where the YAML block opens and closes; zeros where none does."""
        lines = self._lines
        opening = next((index for index, line in enumerate(lines) if _YAML_FENCE.match(line)), None)
        if opening is None:
            return 0, 0
        fence = _YAML_FENCE.sub(r"\1", lines[opening])
        closing = next((i for i in range(opening + 1, len(lines)) if _closes(lines[i], fence)), None)
        return (opening, closing) if closing is not None else (0, 0)


@dataclass(frozen=True, slots=True)
class Sheet:
    """A whole document.

    Attributes:
        view: Sequence number of the rendering it was made from, None where none is named.
        head: Lines above the first section that are not blank; neither 'view' nor notes of refusals.
    """

    view: int | None
    head: tuple[Line, ...]
    sections: tuple[Section, ...]


def decode(data: bytes) -> str:
    """Text of a file, whatever it holds; line ends become one character."""
    return data.decode("utf-8-sig", "backslashreplace").replace("\r\n", "\n").replace("\r", "\n")


def is_whole(data: bytes) -> bool:
    """Whether a file has its end mark: without, its editor is still saving it, or gave up."""
    return END_MARK.strip().encode() in data


def read_sheet(text: str) -> Sheet:
    """Take a document apart."""
    front = _FRONT.match(text[:_FRONT_MAX])
    match = _VIEW.search(front[1]) if front is not None else None
    begin = front.end() if front is not None else 0
    starts = _find_headings(text, begin)
    first = starts[0] if starts else len(text)
    top = _number(text[:begin].split("\n"), 1) if begin else []
    head = (
        *(line for line in top if _VIEW.fullmatch(line[1]) is None),
        *(
            line
            for line in _number(text[begin:first].split("\n"), 1 + text.count("\n", 0, begin))
            if not line[1].startswith(NOTE_MARK.strip())
        ),
    )
    sections, line, counted = [], 1, 0
    for start, end in pairwise([*starts, len(text)]):
        line, counted = line + text.count("\n", counted, start), start
        sections.append(_read_section(text[start:end], line))
    return Sheet(int(match[1]) if match else None, head, tuple(sections))


def _find_headings(text: str, begin: int) -> list[int]:
    """Where each `## name` begins; what is fenced is no heading."""
    found, fence = [], ""
    for match in _LINE_THAT_MATTERS.finditer(text, begin):
        line = match[0]
        if fence:
            fence = "" if _closes(line, fence) else fence
        elif opening := _FENCE.match(line):
            fence = opening["ticks"]
        elif line.startswith("## ") and line[3:].strip():
            found.append(match.start())
    return found


def _closes(line: str, fence: str) -> bool:
    return line.startswith(fence) and not line.rstrip().strip(fence[0])


def _number(lines: list[str], first: int) -> list[Line]:
    return [
        (number, text)
        for number, line in enumerate(lines, first)
        if (text := line.rstrip()) and text != END_MARK.strip()
    ]


def _read_section(text: str, line: int) -> Section:
    text = text.rstrip()
    while text.endswith(END_MARK.strip()):
        text = text.removesuffix(END_MARK.strip()).rstrip()
    heading = text.partition("\n")[0]
    return Section(heading[3:].strip().strip("`").strip(), line, f"{text}\n")
