"""Pieces of Markdown and Mermaid that every view uses, and how a view reaches the disk."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from phyagentos.protocol.verdicts import Criterion, Truth

_MARKS = {Truth.TRUE: "yes", Truth.FALSE: "**no**", Truth.UNKNOWN: "*unknown*"}
_LABEL_CODES = str.maketrans({"#": "#35;", '"': "#quot;", "<": "#lt;", ">": "#gt;", "`": "#96;", ";": "#59;"})


def publish(path: Path, text: str) -> None:
    """Replace a document as a whole: a reader sees the old text or the new one, never half.

    A view can be rendered again at any time, so nothing waits for the disk.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def render_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; cells are escaped and kept on one line."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(escape_cell(cell) for cell in line)} |\n" for line in lines)


def escape_cell(text: str) -> str:
    """Text that cannot break a table."""
    return " ".join(text.split()).replace("|", "\\|")


def escape_label(text: str) -> str:
    """Text that can stand between the double quotes of a Mermaid label."""
    return " ".join(text.translate(_LABEL_CODES).split())


def render_criteria(criteria: Sequence[Criterion]) -> str:
    """What was asked for and what was seen, a row a criterion; empty without any."""
    if not criteria:
        return ""
    rows = (
        (
            f"`{each.text}`",
            each.kind,
            _MARKS[each.truth],
            each.because,
            ", ".join(f"{name} = {format_value(value)}" for name, value in each.measured.items()),
            each.evidence,
        )
        for each in criteria
    )
    return render_table(("criterion", "kind", "holds", "because", "measured", "evidence"), rows) + "\n"


def format_value(value: object) -> str:
    """A measured value for people: four significant digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def format_time(at: str) -> str:
    """The clock time of a record, to the second."""
    return at[11:19]
