"""What the pages for people hold: fenced blocks, commands, links and headings."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXTS = sorted(  # with commands that a reader types
    {
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("examples/*/*.md"),
        *ROOT.glob("phyagentos/cli/scaffold/*.md"),
    }
)
_FENCE = re.compile(
    r"^(?:<!-- not run: (?P<why>[^\n]+) -->\n)?```(?P<kind>\w*)\n(?P<text>.*?)^```", re.MULTILINE | re.DOTALL
)
_INLINE = re.compile(r"`(paos [^`]+)`")
_LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)#?([^)\s]*)\)")
_CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)
_HEADING = re.compile(r"^#+ +(.+?)\s*$", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """The commands of one fenced `console` block, and why no test runs them (empty where one does)."""

    commands: tuple[str, ...]
    why_not_run: str


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def iter_blocks(path: Path) -> Iterator[Block]:
    for fence in _FENCE.finditer(read(path)):
        lines = [line[2:].split(" #")[0].strip() for line in fence["text"].splitlines() if line.startswith("$ ")]
        if fence["kind"] == "console" and lines:
            yield Block(tuple(lines), fence["why"] or "")


def iter_inline_commands(path: Path) -> Iterator[str]:
    yield from _INLINE.findall(_FENCE.sub("", read(path)))


def iter_links(path: Path) -> Iterator[tuple[str, str]]:
    """Target and anchor of each link that leads into the project."""
    yield from _LINK.findall(_CODE.sub("", read(path)))


def find_anchors(path: Path) -> set[str]:
    """Of its headings, as GitHub and the site make them."""
    text = re.sub(r"^```.*?^```", "", read(path), flags=re.MULTILINE | re.DOTALL)
    words = (re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in _HEADING.findall(text))
    return {re.sub(r"[^\w\- ]", "", each).strip().replace(" ", "-") for each in words}
