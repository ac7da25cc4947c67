"""`paos help WORDS`: the how-to pages and the commands that are nearest to a question in words."""

import difflib
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from phyagentos.cli import app
from phyagentos.cli.outcome import fold
from phyagentos.cli.reply import Reply
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import find_shipped_root

PAGES = Path("docs") / "howto"  # below what ships
_MOST_PAGES, _MOST_COMMANDS, _MOST_TYPED, _NEAR = 3, 4, 6, 0.3
_COLUMNS = 98  # of what no terminal bounds
_NAME_WEIGHT = 6.0  # of the words of a file name: `stop` is about stopping before it is about going on after a stop
_STOP_WORDS = frozenset(
    re.findall(
        r"\w+",
        "a an and are be can do does for from get give have how i in into is it its let make me more my of on one or"
        " out set should so some that the their then there this to use want was we what when where which who will with"
        " you your",
    )
)
_ENDINGS = re.compile(r"(ing|edly|ed|er|est|ly|e)$")


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """One page or command: its title, its first lines, what it says to type, and its file (of a page)."""

    title: str
    about: str
    commands: tuple[str, ...] = ()
    file: str = ""


Entry = tuple[Found, dict[str, float]]
"""What can be found, with how much each stem of it says about it."""


def explain(
    context: typer.Context,
    words: Annotated[
        list[str] | None, typer.Argument(metavar="WORDS…", help="A question: make the arm slower.")
    ] = None,
) -> Reply[tuple[Found, ...]]:
    """Find how-to pages and commands by words."""
    if not words:
        return Reply((), context.find_root().get_help())
    files, question = _files(), " ".join(words)
    pages = list(map(read_page, files))
    commands = [_describe(name, *place.split(":")) for name, place in app.PLACES.items()]
    stems = correct(stem_words(question), [*pages, *commands])
    found, near = rank(stems, pages)[:_MOST_PAGES], rank(stems, commands)[:_MOST_COMMANDS]
    if not found and not near:
        raise DefinitionError.unknown("page", "help", question, [path.stem for path in files])
    listed = "\n".join(f"{each.title:<22} {each.about}" for each in near)
    return Reply((*found, *near), "\n\n".join(filter(None, [*map(_show_page, found), listed])))


def read_page(path: Path) -> Entry:
    """A how-to page; title and keywords (`Also: …`) count four times as much as its text, its file name six times."""
    text = path.read_text(encoding="utf-8")
    title, _, body = text.partition("\n")
    prose = re.sub(r"```.*?```|<!--.*?-->|^\|.*?$", "", body, flags=re.DOTALL | re.MULTILINE)
    paragraphs = [" ".join(_plain(each).split()) for each in prose.split("\n\n") if each.strip()]
    keywords = next((each for each in paragraphs if each.startswith("Also: ")), "")
    about = next((each for each in paragraphs if each != keywords), "")
    typed = [line[2:].split("  #")[0].strip() for line in body.splitlines() if line.startswith("$ ")]
    found = Found(title=title.lstrip("# "), about=about, commands=tuple(typed[:_MOST_TYPED]), file=str(path))
    return found, weigh(f"{title} {keywords}", body) | dict.fromkeys(stem_words(path.stem), _NAME_WEIGHT)


def rank(stems: Sequence[str], entries: Sequence[Entry]) -> list[Found]:
    """Those that share stems with a question, the nearest first; far ones are left out."""
    spread = Counter(stem for _, weights in entries for stem in weights)
    rarity = {stem: math.log(1.0 + len(entries) / spread[stem]) for stem in stems if stem in spread}
    scores = [(sum(weights.get(stem, 0.0) * rarity[stem] for stem in rarity), found) for found, weights in entries]
    scores.sort(key=lambda pair: -pair[0])
    return [found for score, found in scores if score > 0.0 and score >= _NEAR * scores[0][0]]


def correct(stems: Iterable[str], entries: Iterable[Entry]) -> list[str]:
    """The stems, one that stands nowhere as the nearest that does."""
    known = sorted({stem for _, weights in entries for stem in weights})
    return [
        near
        for stem in stems
        for near in ([stem] if stem in known else difflib.get_close_matches(stem, known, 1, 0.75))
    ]


def weigh(headline: str, text: str) -> dict[str, float]:
    """How much each stem says about an entry."""
    return dict.fromkeys(stem_words(text), 1.0) | dict.fromkeys(stem_words(headline), 4.0)


def stem_words(text: str) -> list[str]:
    """The words of a text that say something, without their endings: slower, slowly and slow are one."""
    words = (each for each in re.findall(r"[a-z0-9]+", text.lower()) if each not in _STOP_WORDS)
    return [_stem(each) for each in words]


def _stem(word: str) -> str:
    single = re.sub(r"(?<=[^s])s$", "", re.sub(r"ies$", "y", word)) if len(word) > 3 else word
    short = _ENDINGS.sub("", single) if len(single) > 4 else single
    return short[:-1] if len(short) > 3 and short[-1] == short[-2] else short


def _describe(name: str, module: str, function: str) -> Entry:
    about = app.read_summaries(module)[function]
    return Found(title=f"paos {name}", about=about), weigh(name, about)


def _show_page(page: Found) -> str:
    about = fold(f"  {page.about}", _COLUMNS)
    return "\n".join([f"{page.title}  ({page.file})", about, *(f"    $ {each}" for each in page.commands)])


def _files() -> list[Path]:
    return sorted(each for each in (find_shipped_root() / PAGES).glob("*.md") if each.stem != "index")


def _plain(text: str) -> str:
    """Markdown without its links and emphasis."""
    return re.sub(r"\*\*|`", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text))
