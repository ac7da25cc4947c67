"""Pieces of Markdown and Mermaid that every view uses, and how a view reaches the disk."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from phyagentos.protocol.document import Front
from phyagentos.protocol.memory_entries import MemoryEntry
from phyagentos.protocol.store.bodies import render_yaml
from phyagentos.protocol.verdicts import Criterion, Truth

_MARKS = {Truth.TRUE: "yes", Truth.FALSE: "**no**", Truth.UNKNOWN: "*unknown*"}
_LABEL_CODES = str.maketrans(
    {"#": "#35;", '"': "#quot;", "<": "#lt;", ">": "#gt;", "`": "#96;", ";": "#59;"}
    | {"&": "#amp;", "%": "#37;", "{": "#123;", "}": "#125;", "\\": "#92;"}
    | {":": "#58;"}  # Mermaid takes the code of a later sign in `style a:…` or `classDef a:…` for one of its own
)


def publish(path: Path, text: str) -> None:
    """Replace a document as a whole: a reader sees the old text or the new one, never half.

    A view can be rendered again at any time, so nothing waits for the disk.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def render_front(front: Front) -> str:
    """The lines at the top of a document."""
    return f"---\n{render_yaml(front)}---\n\n"


def render_block(value: Any) -> str:
    """The fenced block of one struct or mapping."""
    return f"```yaml\n{render_yaml(value)}```\n"


def render_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; cells are escaped and kept on one line."""
    return "".join(map(render_row, [head, ["---"] * len(head), *rows]))


def render_row(cells: Iterable[str]) -> str:
    """One line of a table."""
    return f"| {' | '.join(map(escape_cell, cells))} |\n"


def flatten(text: str) -> str:
    """Text on one line: what somebody wrote can then neither begin a heading nor a fence."""
    return " ".join(text.split())


def escape_cell(text: str) -> str:
    """Text that cannot break a table."""
    return flatten(text).replace("|", "\\|")


def escape_label(text: str) -> str:
    """Text that can stand between the double quotes of a Mermaid label."""
    return flatten(text.translate(_LABEL_CODES))


def render_link(target: str, text: str = "") -> str:
    """A link to a file or folder of the workspace; empty without one."""
    return f"[{text or target}]({target.replace(' ', '%20')})" if target else ""


def render_criteria(criteria: Sequence[Criterion], folder: str = "") -> str:
    """What was asked for and what was seen, a row a criterion; empty without any.

    Args:
        criteria: As judged.
        folder: Of the bundle, relative to the workspace; the evidence is then a link.
    """
    if not criteria:
        return ""
    rows = (
        (
            f"`{each.text}`",
            each.kind,
            _MARKS[each.truth],
            each.because,
            ", ".join(f"{name} = {format_value(value)}" for name, value in each.measured.items()),
            render_link(str(PurePosixPath(folder) / each.evidence), each.evidence)
            if folder and each.evidence
            else each.evidence,
        )
        for each in criteria
    )
    return render_table(("criterion", "kind", "holds", "because", "measured", "evidence"), rows) + "\n"


def render_entries(front: Front, head: str, entries: Iterable[MemoryEntry], nothing: str) -> str:
    """A document of memory entries: a section each, the statement first, then all of it as YAML."""
    sections = [f"## {each.id}\n\n> {flatten(each.statement)}\n\n{render_block(each)}\n" for each in entries]
    return f"{render_front(front)}{head}{''.join(sections) or nothing}"


def format_value(value: object) -> str:
    """A measured value for people: four significant digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def format_moment(at: str) -> str:
    """The wall time of a record for people, to the second."""
    return f"{at[:10]} {at[11:19]} UTC" if at else ""


def format_time(at: str) -> str:
    """The clock time of a record, to the second."""
    return at[11:19]
