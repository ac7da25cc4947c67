"""What the text of ScienceWorld says: the room, what is seen in it, what contains what, and the doors."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

CARRIED = "inventory"
_ARTICLE = re.compile(r"^(?:an?|the|some|A|substance called|a substance called) ", re.IGNORECASE)
_NESTED = re.compile(r"\.? *\b(?:On|In) the [\w\s'-]+? (?:is|you see): ")
_STAGE = re.compile(r"^(?P<name>.+?) in the (?P<stage>\w+) stage")
_BEFORE = {"baby", "hatchling", "juvenile", "adult", "dead"}
_AFTER = {"egg", "seed", "caterpillar", "pupa", "tadpole", "larva", "nymph"}
_TAIL = re.compile(r"(?:, (?:which is|currently|with:)| titled |\. The | \(that |its terminal ).*$", re.DOTALL)
_DOOR = re.compile(r"A door to the (?P<room>[\w ]+) \(that is (?P<state>open|closed)\)")


@dataclass(frozen=True)
class Seen:
    """One object that is in view.

    Attributes:
        name: As actions name it.
        text: All that is said of it.
        inside: Names of what holds it, the innermost first; `inventory` where it is carried, empty on the floor.
        stage: Of its life, where that is said: `seed`, `seedling`, `adult`, `egg`.
        holds: Whether something is said to be in it or on it.
    """

    name: str
    text: str
    inside: tuple[str, ...] = ()
    stage: str = ""
    holds: bool = False

    def has(self, state: str) -> bool:
        """Whether this is said of it."""
        return state in self.text


@dataclass(frozen=True)
class Room:
    """A room as it is seen now: its name, its objects, and whether each door, by where it leads, is open."""

    name: str
    seen: tuple[Seen, ...]
    doors: dict[str, bool]


def read_room(look: str, carried: str) -> Room:
    """The room that two texts describe: what looking around says, and what is carried."""
    head, _, rest = look.partition("\n")
    objects, _, doors = rest.partition("You also see:")
    name = re.search(r"called the ([\w ]+)\.", head)
    lines = [line.strip() for line in objects.splitlines()]
    held = [line.strip() for line in carried.splitlines()[1:]]
    seen = [each for line in lines if line for each in _read_item(line, ())]
    seen += [each for line in held if line for each in _read_item(line, (CARRIED,))]
    kept = tuple(each for each in seen if each.name not in ("agent", "air", "nothing"))
    found = {m["room"]: m["state"] == "open" for m in _DOOR.finditer(doors)}
    return Room(name[1] if name else "", kept, found)


def _read_item(text: str, inside: tuple[str, ...]) -> Iterator[Seen]:
    nested = _NESTED.search(text)
    brackets = re.search(r"\(containing (?P<content>.*)\)", text)
    if brackets and (nested is None or brackets.start() < nested.start()):
        head, content = text[: brackets.start()], brackets["content"]
    elif nested:
        head, content = text[: nested.start()], text[nested.end() :]
    else:
        head, content = text, ""
    me = _make(head.strip(" ."), text, inside, holds=content.strip(" .") not in ("", "nothing"))
    yield me
    for part in _split(content):
        yield from _read_item(part, (me.name, *inside))


def _make(head: str, text: str, inside: tuple[str, ...], *, holds: bool) -> Seen:
    own = head if len(head) > 1 else text
    plain = _ARTICLE.sub("", _ARTICLE.sub("", _TAIL.sub("", head)))
    if found := _STAGE.match(plain):
        return Seen(found["name"], own, inside, found["stage"], holds)
    return Seen(plain, own, inside, _find_stage(plain), holds)


def _find_stage(name: str) -> str:
    words = name.split() or [""]
    first, last = words[0], words[-1]
    return first if first in _BEFORE else last if last in _AFTER else ""


def _split(content: str) -> list[str]:
    """The parts of a list, without what says more of the part before it."""
    parts, depth, start = list[str](), 0, 0
    for at, letter in enumerate(content):
        depth += (letter == "(") - (letter == ")")
        if letter == "," and depth == 0:
            parts.append(content[start:at])
            start = at + 1
    parts.append(content[start:])
    joined = list[str]()
    for part in (each.strip(" .") for each in parts):
        if joined and part.startswith(("which is", "currently", "with:")):
            joined[-1] += f", {part}"
        elif part:
            joined.append(part)
    return joined
