"""LOG.md: what happened, one line an event, for people; programs read the journal."""

import re
from typing import Any

import msgspec

from phyagentos.errors import DefinitionError, Problem, raise_any
from phyagentos.protocol.documents.document import DocumentFormat, FrontMatter, read_document

_DAY = re.compile(r"## (\d{4}-\d{2}-\d{2})")
_LINE = re.compile(r"- (?P<time>\d\d:\d\d:\d\d) \*\*(?P<about>.+?)\*\* \((?P<by>.*?)\) (?P<text>.*)")


class LogFront(FrontMatter, frozen=True, kw_only=True, omit_defaults=True):
    """The front matter of LOG.md.

    Attributes:
        older: Number of journal records before the first line; they are not shown here.
    """

    older: int = 0


class LogLine(msgspec.Struct, frozen=True, kw_only=True):
    """One event.

    Attributes:
        at: UTC wall time, to the second (`2026-11-21T14:31:07Z`).
        about: Session, goal or `<goal>/<node>`.
        by: Who recorded it.
        text: What happened.
    """

    at: str
    about: str
    by: str
    text: str


class Log(msgspec.Struct, frozen=True, kw_only=True):
    """The content of LOG.md, oldest line first."""

    front: LogFront
    lines: tuple[LogLine, ...] = ()


LOG: DocumentFormat[Any] = DocumentFormat(
    name="log",
    file="LOG.md",
    summary="What happened, one line an event, newest last; each takes its day from the heading above it.",
    block=None,
    front=LogFront,
    lines=LogLine,
)


def read_log(text: str, source: str = "") -> Log:
    """Read LOG.md; raises DefinitionError with every problem at file:line:column."""
    source = source or LOG.file
    lines, problems = _read_lines(text, source)
    try:
        front = read_document(text, LOG, source).front
    except DefinitionError as error:
        problems += error.problems
    raise_any(problems)
    return Log(front=msgspec.convert(msgspec.to_builtins(front), LogFront), lines=tuple(lines))


def _read_lines(text: str, source: str) -> tuple[list[LogLine], list[Problem]]:
    lines: list[LogLine] = []
    problems: list[Problem] = []
    day = ""
    for number, line in enumerate(text.split("\n"), 1):
        if match := _DAY.fullmatch(line):
            day = match[1]
        elif day and line:
            if match := _LINE.fullmatch(line):
                at = f"{day}T{match['time']}Z"
                lines.append(LogLine(at=at, about=match["about"], by=match["by"], text=match["text"]))
            else:
                expected = "'- hh:mm:ss **about** (by) text' or '## yyyy-mm-dd'"
                problems.append(Problem("INVALID_VALUE", f"{source}:{number}:1", repr(line[:40]), expected))
    return lines, problems
