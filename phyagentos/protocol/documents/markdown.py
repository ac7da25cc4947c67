"""Pieces of Markdown and Mermaid that every view uses, and how a view reaches the disk."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from phyagentos.protocol.documents.body_codec import render_yaml
from phyagentos.protocol.documents.document import Front
from phyagentos.protocol.documents.plain_text import clean

_LABEL_CODES = str.maketrans(
    {"#": "#35;", "¶": "#182;", "ﬂ": "#64258;", '"': "#quot;", "<": "#lt;", ">": "#gt;", "`": "#96;", ";": "#59;"}
    | {"&": "#amp;", "%": "#37;", "{": "#123;", "}": "#125;", "\\": "#92;"}
    | {":": "#58;"}  # Mermaid takes the code of a later sign in `style a:…` or `classDef a:…` for one of its own
)


def publish(path: Path, text: str) -> None:
    """Replace a document as a whole, as it can be rendered again, nothing waits for the disk."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    write_anew(temporary, text)
    temporary.replace(path)


def write_anew(path: Path, text: str) -> None:
    """Write a file in place of what has its name; a link is not followed, unfit characters are escaped."""
    path.unlink(missing_ok=True)
    with path.open("x", encoding="utf-8", errors="backslashreplace") as file:
        file.write(text)


def render_front(front: Front) -> str:
    """The lines at the top of a document."""
    return f"---\n{render_yaml(front)}---\n\n"


def render_block(value: object) -> str:
    """The fenced block of one struct or mapping."""
    return f"```yaml\n{render_yaml(value)}```\n"


def render_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; cells are escaped and kept on one line."""
    return "".join(map(render_row, [head, ["---"] * len(head), *rows]))


def render_row(cells: Iterable[str]) -> str:
    """One line of a table."""
    return f"| {' | '.join(map(escape_cell, cells))} |\n"


def flatten(text: str) -> str:
    """Text on one line, which can begin neither a heading nor a fence, and commands no terminal that shows it."""
    return " ".join(clean(text).split())


def escape_cell(text: str) -> str:
    """Text that cannot break a table."""
    return flatten(text).replace("|", "\\|")


def escape_label(text: str) -> str:
    """Text that can stand between the double quotes of a Mermaid label."""
    return flatten(text.translate(_LABEL_CODES))


def render_link(target: str, text: str = "") -> str:
    """A link to a file or folder of the workspace; empty without one."""
    return f"[{text or target}]({target.replace(' ', '%20')})" if target else ""


def format_value(value: object) -> str:
    """A measured value for people: four significant digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def format_moment(at: str) -> str:
    """The wall time of a record for people, to the second."""
    return f"{at[:10]} {at[11:19]} UTC" if at else ""


def format_time(at: str) -> str:
    """The clock time of a record, to the second."""
    return at[11:19]
