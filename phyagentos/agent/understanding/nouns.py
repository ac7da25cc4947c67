"""What noun phrases mean: `every cube except the red one`, `it`, `the rest`, `two of them`, `the tray of its colour`.

Upstream: a reading. Downstream: the clauses. What is open becomes a question with its candidates, what is not here a
lack; a phrase is never taken for the nearest thing.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from lark import Token, Tree

from phyagentos.agent.understanding.reading import pluralise
from phyagentos.agent.understanding.understanding import Lack, LackKind, Question, QuestionKind
from phyagentos.agent.understanding.vocabulary import LOOSE, SURFACES, Thing, Vocabulary
from phyagentos.errors import find_nearest

Node = Tree[Token]
NUMBERS = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]


class Slot(StrEnum):
    """What a phrase is needed for; it decides what `it`, `everything` and a bare colour can mean."""

    MOVED = "moved"
    """A thing that is taken elsewhere."""
    PLACE = "place"
    """Where it is put."""
    OPENS = "opens"
    """A thing with a joint."""
    VESSEL = "vessel"
    """A thing that others can be in."""
    LOOSE = "loose"
    """Nameless contents of a vessel, or the vessel."""
    ANY = "any"
    """Any thing."""

    def takes(self, thing: Thing) -> bool:
        """Whether a thing is fit for it."""
        fits = {"moved": thing.movable, "opens": bool(thing.opens), "vessel": thing.has_interior}
        return fits.get(self, bool(thing.contents) if self is Slot.LOOSE else True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Named:
    """The things that a phrase means.

    Attributes:
        by_colour: Each object takes the one of its own colour.
        rest: Things of the same noun that the phrase excludes by `only` or `exactly`.
        only: Whether it says `only`.
        number: The number in it, 0 without one.
    """

    names: tuple[str, ...] = ()
    words: str = ""
    by_colour: bool = False
    rest: tuple[str, ...] = ()
    only: bool = False
    number: int = 0


@dataclass(slots=True, kw_only=True)
class Discourse:
    """What was said so far, and what was found to be open or missing.

    Attributes:
        answers: Key of a question -> candidate.
        recent: Things that each clause named, the latest clause last.
        moved: Everything that some clause puts somewhere, in order.
        heads: The last noun of each slot.
        unmet: A phrase with `only`, `exactly` or `of its colour`, until a clause says what becomes of it.
    """

    text: str
    vocabulary: Vocabulary
    answers: Mapping[str, str]
    questions: list[Question] = field(default_factory=list)
    lacks: list[Lack] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    chosen: list[str] = field(default_factory=list)
    unsaid: list[str] = field(default_factory=list)
    recent: list[list[str]] = field(default_factory=lambda: [[]])
    moved: list[str] = field(default_factory=list)
    heads: dict[Slot, str] = field(default_factory=dict)
    unmet: str = ""

    def lack(self, kind: LackKind, words: str, possible: Iterable[str] = ()) -> None:
        """Note that something is missing."""
        known = tuple(possible)
        near = find_nearest(words.replace(" ", "_"), known) or ""
        self.lacks.append(Lack(kind=kind, words=words, nearest=near, possible=known))

    def ask(self, kind: QuestionKind, phrase: Node, candidates: Iterable[str], about: str = "") -> tuple[str, ...]:
        """The answer to a question, or nothing and the question noted."""
        words, possible = " ".join(filter(None, (about, self.quote(phrase)))), tuple(candidates)
        key = f"{words}@{phrase.meta.start_pos}"
        if (answer := self.answers.get(key)) in possible:
            return (str(answer),)
        self.questions.append(Question(kind=kind, key=key, words=words, candidates=possible))
        return ()

    def quote(self, tree: Node) -> str:
        """The words of a part of the request."""
        return self.text[tree.meta.start_pos : tree.meta.end_pos]

    def resolve(self, things: Node, slot: Slot, *, forbids: bool = False) -> Named:
        """The things of a list of phrases; `forbids` where it says what must not be, so that `a cube` is every one."""
        parts = [child for child in list_children(things) if child.data != "except"]
        is_pair = len(parts) == 2 and any(parts[0].find_data("both"))  # `both the red and the green cube`
        named = [
            self.resolve_one(part, slot, lent=self._lend(parts[n + 1 :]), forbids=forbids, is_pair=is_pair)
            for n, part in enumerate(parts)
        ]
        names = tuple(dict.fromkeys(name for each in named for name in each.names))
        exceptions = [child for child in list_children(things) if child.data == "except"]
        head, here = self.heads.get(slot, ""), self.vocabulary.things.values()
        alike = [thing.name for thing in here if head in thing.heads] if any(each.only for each in named) else []
        rest = (*alike, *(name for each in named for name in each.rest))
        return Named(
            names=self.remove(names, exceptions, slot),
            words=self.quote(things),
            by_colour=any(each.by_colour for each in named),
            rest=tuple(name for name in rest if name not in names),
            number=named[0].number,
        )

    def remove(self, names: tuple[str, ...], exceptions: Iterable[Node], slot: Slot) -> tuple[str, ...]:
        """The names without those of exceptions, each of which has to be among them."""
        for exception in exceptions:
            excepted = self.resolve_except(exception, slot)
            if names and not set(excepted) <= set(names):
                self.lack(LackKind.THING, self.quote(exception), names)
            names = tuple(name for name in names if name not in excepted)
        return names

    def resolve_except(self, exception: Node, slot: Slot) -> tuple[str, ...]:
        """The things that an exception names."""
        parts = list_children(exception)
        found = [self.resolve_one(part, slot, lent=self._lend(parts[n + 1 :])) for n, part in enumerate(parts)]
        return tuple(name for each in found for name in each.names)

    def resolve_one(
        self, noun: Node, slot: Slot, *, lent: str = "", forbids: bool = False, is_pair: bool = False
    ) -> Named:
        """The things of one phrase; none where it is open or where there is none."""
        match noun.data:
            case "it":
                named = Named(names=self.find_it(noun, slot))
            case "them":
                named = Named(names=self._find_them(noun))
            case "everything":
                names = self._find_everything(noun, slot)
                number = sum(thing.contents for thing in self._get_all(names)) if slot is Slot.LOOSE else 0
                named = Named(names=names, number=number)
            case "everything_else":
                found = self._find_everything(noun, slot)
                named = Named(names=tuple(name for name in found if name not in self.moved))
            case "others":
                named = Named(names=self._find_others(noun, slot))
            case _:
                named = self._find_quantified(noun, slot, lent, forbids=forbids, is_pair=is_pair)
        self.recent[-1] += [name for name in named.names if name not in self.recent[-1]]
        if named.only or named.rest or named.by_colour:
            self.unmet = self.quote(noun)
        return replace(named, words=self.quote(noun))

    def resolve_aside(self, noun: Node, slot: Slot) -> Named:
        """As `resolve_one`, of a phrase that `it` will not mean."""
        recent = [*self.recent[-1]]
        named = self.resolve_one(noun, slot)
        self.recent[-1] = recent
        return named

    def restrict(self, objects: Named, source: Node) -> Named:
        """Of several things those that stand in or on what `from` names; one thing is taken from wherever it is."""
        owners = self.resolve_aside(source, Slot.PLACE).names
        if len(objects.names) < 2 or not owners:
            return objects
        names = [each.name for each in self._list_standing(self._get_all(objects.names), owners)]
        if not names:
            self.lack(LackKind.THING, f"{objects.words} from {self.quote(source)}", objects.names)
        return replace(objects, names=tuple(names))

    def find_it(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """The one fitting thing that the latest clause with any named; several are asked about."""
        for before in reversed(self.recent[:-1]):
            things = self._get_all(name for name in before if name not in self.recent[-1])
            found = [thing.name for thing in things if slot.takes(thing)]
            if found:
                return (found[0],) if len(found) == 1 else self.ask(QuestionKind.WHICH, phrase, found)
        self.lack(LackKind.SENTENCE, self.quote(phrase))
        return ()

    def _get_all(self, names: Iterable[str]) -> list[Thing]:
        return [self.vocabulary.things[name] for name in names]

    def _lend(self, parts: Iterable[Node]) -> str:
        """The first noun of the phrases that follow: `the red and the green cube` lends its noun to the first."""
        plains = (plain for part in parts for plain in part.find_data("plain"))
        return next((head for plain in plains if (head := self._read_head(plain)[0])), "")

    def _iter_fitting(self, slot: Slot) -> Iterable[Thing]:
        """Things that a slot can take, for phrases that say no noun."""
        return (thing for thing in self.vocabulary.things.values() if slot.takes(thing))

    def _find_everything(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        colours = {str(token) for token in noun.children if get_type(token) == "elliptic"}
        fitting = [thing for thing in self._iter_fitting(slot) if slot is not Slot.ANY or thing.movable or thing.opens]
        found = [thing for thing in fitting if colours <= thing.words]
        for tail in list_children(noun):
            found = self._filter(found, tail)
        if not found:
            self.lack(LackKind.THING, self.quote(noun))
        return tuple(thing.name for thing in found)

    def _find_them(self, noun: Node) -> tuple[str, ...]:
        groups = (
            [each.name for each in self._get_all(before) if each.movable] for before in reversed(self.recent[:-1])
        )
        found = next((group for group in groups if len(group) > 1), [*dict.fromkeys(self.moved)])
        if len(found) < 2:
            self.lack(LackKind.SENTENCE, self.quote(noun))
        return tuple(found) if len(found) > 1 else ()

    def _find_others(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        plain = find_child(noun, "plain")
        head = self.heads.get(slot, "")
        here = [each.name for each in self.vocabulary.things.values() if head in each.heads]
        fitting = here if head else [each.name for each in self._iter_fitting(slot)]
        found = self._find_candidates(plain, slot, "")[0] if plain is not None else fitting
        names = tuple(name for name in found if name not in self.moved) if self.moved else ()
        if not names:
            self.lack(LackKind.THING, self.quote(noun), found)
        return names

    def _find_quantified(self, noun: Node, slot: Slot, lent: str, *, forbids: bool, is_pair: bool) -> Named:
        *quantities, plain = list_children(noun)
        quantity = quantities[0] if quantities else None
        found, is_plural, by_colour = self._find_candidates(plain, slot, lent)
        kind, number, words = "the", 0, self.quote(noun)
        if quantity is not None:
            kind = "the" if is_pair and quantity.data == "both" else str(quantity.data)
            number = next((_count(str(each)) for each in quantity.children if get_type(each) == "number"), 0)
            if has_token(quantity, "other"):
                before = self._list_mentioned(slot)
                found = [name for name in found if name not in before] if {*before} & {*found} else []
        if slot is Slot.LOOSE:
            held = sum(thing.contents for thing in self._get_all(found))
            return Named(names=tuple(found), number=held if kind == "all" and not number else number)
        if not found:
            self.lack(LackKind.THING, words, self.vocabulary.things)
        named = Named(names=tuple(found), words=words, by_colour=by_colour)
        if kind == "their" and slot is Slot.PLACE and len(found) > 1 and not by_colour:
            self.reasons.append(f"{words}: the one of the same colour")
            named = replace(named, by_colour=True)
        if named.by_colour or not found:
            return named
        counts = {"both": 2, "all": number or len(found), "the_number": number, "some": -1}
        if kind in counts:
            if counts[kind] != len(found):
                self.ask(QuestionKind.HOW_MANY, noun, found)
                return Named()
            return named
        if kind in {"number", "exactly", "any"}:
            every = forbids and kind == "any"
            return named if every else self._choose(named, max(number, 1), keeps_rest=kind == "exactly")
        every = is_plural or (forbids and quantity is None)  # `no crumb` is every one
        if kind == "same" or (len(found) > 1 and not every):
            return Named(names=self.ask(QuestionKind.WHICH, noun, found))
        return replace(named, only=kind == "only")

    def _choose(self, named: Named, number: int, *, keeps_rest: bool) -> Named:
        """The first of several, where any will do; those that were moved already come last."""
        if number > len(named.names):
            self.lack(LackKind.THING, named.words, named.names)
            return Named()
        ordered = sorted(named.names, key=lambda name: name in self.moved)
        names = tuple(name for name in named.names if name in ordered[:number])
        if number < len(named.names):
            self.chosen += names
            self.reasons.append(f"{named.words}: {', '.join(names)}, as any of {', '.join(named.names)} will do")
        return Named(names=names, rest=named.names if keeps_rest else ())

    def _list_mentioned(self, slot: Slot) -> list[str]:
        """What `other` excludes: what was moved; of places, where the thing of this clause stands."""
        recent = self.recent[-1]
        return [each.stands for each in self._get_all(recent)] if slot is Slot.PLACE else [*self.moved, *recent]

    def _find_candidates(self, plain: Node, slot: Slot, lent: str) -> tuple[list[str], bool, bool]:
        """Names that a noun with its words fits, whether it is a plural, and whether each goes by colour."""
        tokens = [child for child in plain.children if isinstance(child, Token)]
        adjectives = {str(token) for token in tokens if get_type(token) in {"adj", "elliptic"}}
        by_colour = has_token(plain, "matching") or has_token(plain, "of_its_colour")
        head, is_plural, is_generic = self._read_head(plain)
        things = self.vocabulary.things.values()
        if head == LOOSE and slot is Slot.LOOSE and not any(head in thing.heads for thing in things):
            return [thing.name for thing in things if thing.contents], True, False
        self.heads |= {slot: head} if head else {}
        last = head or lent or self.heads.get(slot, "")
        named = [] if is_generic else [thing for thing in things if last in thing.heads]
        if not head and not any(adjectives <= thing.words for thing in named):
            named = [*self._iter_fitting(Slot.MOVED if slot is Slot.PLACE and is_generic else slot)]
        found = [thing for thing in named if adjectives <= thing.words]
        if not head and not is_generic:  # `green` alone is the green cube rather than a bottle of green glass
            found = [thing for thing in found if adjectives <= {*thing.name.split("_")}] or found
        for tail in (child for child in list_children(plain) if child.data != "head"):
            found = self._filter(found, tail)
        return [thing.name for thing in found], is_plural, by_colour

    def _read_head(self, plain: Node) -> tuple[str, bool, bool]:
        """The noun of the scene in a phrase, empty without one; whether it is a plural, and whether it is `thing`."""
        head = find_child(plain, "head")
        token = head.children[0] if head is not None else ""
        word = " ".join(str(token).split())
        if get_type(token) != "noun":
            return "", word.endswith("s"), get_type(token) == "thing"
        nouns = self.vocabulary.list_words()[1]
        one = word if word in nouns else next(noun for noun in nouns if pluralise(noun) == word)
        return one, word != one, False

    def _filter(self, found: Iterable[Thing], tail: Node) -> list[Thing]:
        """Those that are parts of, or stand in or on, what the tail names, as the scene begins."""
        heads = dict(self.heads)
        owners, *_ = self._find_candidates(list_children(tail)[0], Slot.ANY, "")
        self.heads = heads
        if tail.data == "part_of":
            return [thing for thing in found if thing.part_of in owners]
        return self._list_standing(found, owners)

    def _list_standing(self, found: Iterable[Thing], owners: Iterable[str]) -> list[Thing]:
        """Those that stand in or on any of some things as the scene begins; where none is said it is the table."""
        kinds = {thing.kind for thing in self._get_all(owners)}
        return [thing for thing in found if thing.stands in owners or (not thing.stands and kinds & {*SURFACES})]


def list_children(tree: Node) -> list[Node]:
    """Parts of a phrase that are phrases."""
    return [child for child in tree.children if isinstance(child, Tree)]


def find_child(tree: Node, rule: str) -> Node | None:
    """The part of a phrase that a rule made, or None."""
    return next((child for child in list_children(tree) if child.data == rule), None)


def has_token(tree: Node, terminal: str) -> bool:
    """Whether a phrase itself, not its parts, has a word of some kind."""
    return any(isinstance(child, Token) and child.type == terminal.upper() for child in tree.children)


def get_type(part: object) -> str:
    """The terminal of a word; empty for a phrase."""
    return part.type.lower() if isinstance(part, Token) else ""


def _count(word: str) -> int:
    return NUMBERS.index(word) if word in NUMBERS else int(word)
