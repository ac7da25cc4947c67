"""What noun phrases mean: `every cube except the red one`, `it`, `the rest`, `two of them`, `the tray of its colour`.

Upstream: a reading. Downstream: the clauses. What is open becomes a question with its candidates, what is not here a
lack; a phrase is never taken for the nearest object.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from lark import Token, Tree

from phyagentos.agent.understanding.bearings import (
    SIDES,
    VIEWS,
    is_within,
    lies_between,
    list_beside,
    list_most,
    list_nth,
)
from phyagentos.agent.understanding.reading import pluralise
from phyagentos.agent.understanding.understanding import (
    Ambiguous,
    Impossible,
    Question,
    QuestionKind,
    RequestProblem,
    RequestProblemKind,
)
from phyagentos.agent.understanding.vocabulary import LOOSE, REGION, SURFACES, Thing, Vocabulary, read_lexicon
from phyagentos.errors import find_nearest
from phyagentos.protocol.predicates.predicate import find_entities

Node = Tree[Token]
_POSITIONS = {*SIDES, "top", "bottom", "middle"}  # words that choose one of several
_OWNED = {"part_of", "located"}  # tails of a noun that name what it belongs to, or is in or on
ORDINALS = ["first", "second", "third", "fourth", "fifth"]
NUMBERS = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]


class Slot(StrEnum):
    """What a phrase is needed for; it decides what `it`, `everything` and a bare colour can mean."""

    MOVED = "moved"  # an object that is taken elsewhere
    PLACE = "place"  # where it is put
    OPENS = "opens"  # an object with a joint
    VESSEL = "vessel"  # an object that others can be in
    LOOSE = "loose"  # nameless contents of a vessel, or the vessel
    ANY = "any"

    def takes(self, thing: Thing) -> bool:
        """Whether an object is fit for it."""
        fits = {"moved": thing.movable, "opens": thing.opens, "vessel": thing.has_interior, "loose": thing.contents}
        return bool(fits.get(self, True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Named:
    """The objects that a phrase means.

    Attributes:
        by_colour: Each object takes the one of its own colour.
        rest: Objects of the same noun that the phrase excludes by `only` or `exactly`.
        spare: Objects that would have done as well, where the choice was left open.
        number: The number in it, 0 without one.
    """

    names: tuple[str, ...] = ()
    words: str = ""
    by_colour: bool = False
    rest: tuple[str, ...] = ()
    spare: tuple[str, ...] = ()
    only: bool = False
    number: int = 0


@dataclass(slots=True, kw_only=True)
class Discourse:
    """What was said so far, and what was found to be open or missing.

    Attributes:
        recent: Objects that each clause named, the latest clause last.
        moved: Everything that some clause puts somewhere, in order.
        grouped: Objects that a phrase named together with others, as `the cubes`.
        spared: Everything that some clause says to leave as it is: `the others` are none of it.
        heads: The last noun of each slot.
        among: Those of which an exception takes some away.
        view: Whose left and right are meant, as in `VIEWS`; 0 where a request does not say.
        kin: Those of which a phrase chose some, as `one red cube`: `the other` is one of them.
        unmet: A phrase with `only`, `exactly` or `of its colour`, until a clause says what becomes of it.
    """

    text: str
    vocabulary: Vocabulary
    answers: Mapping[str, str]
    questions: list[Question] = field(default_factory=list)
    lacks: list[RequestProblem] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    chosen: list[str] = field(default_factory=list)
    unsaid: list[str] = field(default_factory=list)
    recent: list[list[str]] = field(default_factory=lambda: [[]])
    moved: list[str] = field(default_factory=list)
    spared: list[str] = field(default_factory=list)
    grouped: set[str] = field(default_factory=set)
    heads: dict[Slot, str] = field(default_factory=dict)
    kin: tuple[str, ...] = ()
    among: tuple[str, ...] = ()
    view: float = 0.0
    unmet: str = ""

    def lack(self, kind: RequestProblemKind, words: str | Node, possible: Iterable[str] = ()) -> tuple[str, ...]:
        """Note that something is missing: words, or those of a phrase; there is nothing then."""
        words, known = words if isinstance(words, str) else self.quote(words), tuple(possible)
        near = find_nearest(words.replace(" ", "_"), known) or ""
        self.lacks.append(RequestProblem(kind=kind, words=words, nearest=near, possible=known))
        return ()

    def conclude(self) -> Ambiguous | Impossible | None:
        """What is missing, else what is open; None where neither."""
        if self.lacks:
            return Impossible(lacks=tuple(dict.fromkeys(self.lacks)))
        return Ambiguous(questions=tuple(dict.fromkeys(self.questions))) if self.questions else None

    def ask(
        self, kind: QuestionKind, phrase: Node, candidates: Iterable[str], about: str = "", likely: str = ""
    ) -> tuple[str, ...]:
        """The answer to a question, or nothing and the question noted."""
        words, possible = f"{about} {self.quote(phrase)}".strip(), tuple(candidates)
        key = f"{words}@{_list_tokens(phrase)[0].start_pos}"
        if (answer := self.answers.get(key)) in possible:
            return (str(answer),)
        self.questions.append(Question(kind=kind, key=key, words=words, candidates=possible, likely=likely))
        return ()

    def ask_view(self, phrase: Node) -> float | None:
        """1 where the robot's view is meant, -1 for that of a person who faces it; None and a question where open."""
        return self.view or next((VIEWS[each] for each in self.ask(QuestionKind.VIEW, phrase, VIEWS)), None)

    def quote(self, tree: Node) -> str:
        """The words of a part of the request."""
        tokens = _list_tokens(tree)
        return self.text[tokens[0].start_pos : tokens[-1].end_pos]

    def get(self, name: str) -> Thing:
        """An object by its name."""
        return self.vocabulary.things[name]

    def list_fitting(self, slot: Slot) -> list[Thing]:
        """Objects that a slot can take, for phrases that say no noun."""
        return [thing for thing in self.vocabulary.things.values() if slot.takes(thing)]

    def resolve(self, things: Node, slot: Slot, *, forbids: bool = False) -> Named:
        """The objects of a list of phrases; `forbids` where it says what must not be, so that `a cube` is every one."""
        parts = [child for child in list_children(things) if child.data != "except"]
        is_pair = len(parts) == 2 and any(parts[0].find_data("both"))  # `both the red and the green cube`
        named = self._resolve_parts(parts, slot, forbids=forbids, is_pair=is_pair)
        if slot is Slot.LOOSE and len(named) > 1:  # two numbers are no one number
            self.lack(RequestProblemKind.SENTENCE, things)
        names = tuple(dict.fromkeys(name for each in named for name in each.names))
        if len(parts) > 1 and self._is_of_both(*parts[:2]):
            self.ask(QuestionKind.HOW_MANY, things, names)
        alike = self.list_called(self.heads.get(slot, ""), slot) if any(each.only for each in named) else []
        rest = (*(thing.name for thing in alike), *(name for each in named for name in each.rest))
        spare = tuple(name for each in named for name in each.spare if name not in names)
        return Named(
            names=self.remove(names, things, slot, spare),
            spare=spare,
            words=self.quote(things),
            by_colour=any(each.by_colour for each in named),
            rest=tuple(name for name in rest if name not in names),
            number=named[0].number,
        )

    def _is_of_both(self, first: Node, second: Node) -> bool:
        """Whether a number may count both phrases: `one of the red and blue cubes`."""
        is_counted = any(find_child(first, each) is not None for each in ("any", "number", "exactly", "half"))
        plain = list_children(first)[-1]
        return is_counted and find_child(plain, "head") is None and len(list_children(second)) == 1

    def remove(self, names: tuple[str, ...], phrase: Node, slot: Slot, spare: Sequence[str] = ()) -> tuple[str, ...]:
        """The names without those of a phrase's exceptions, each of which has to be among them or those to spare.

        Of `two cubes, but not the red one` a spare one takes its place.
        """
        for exception in (child for child in list_children(phrase) if child.data == "except"):
            excepted = self.resolve_except(exception, slot, (*names, *spare))
            number, fresh = len(names) if spare else 0, [name for name in spare if name not in excepted]
            if names and not set(excepted) <= {*names, *spare}:
                self.lack(RequestProblemKind.THING, exception, names)
            names = tuple(name for name in names if name not in excepted)
            more = fresh[: max(number - len(names), 0)]
            if len(names) + len(more) < number:
                self.lack(RequestProblemKind.THING, phrase, (*names, *more))
            self.reasons += [f"{self.quote(exception)}: {name} instead" for name in more]
            self.chosen = [name for name in (*self.chosen, *more) if name not in excepted]
            names += tuple(more)
        return names

    def resolve_except(self, exception: Node, slot: Slot, among: tuple[str, ...] = ()) -> tuple[str, ...]:
        """The objects that an exception names, of those that it is an exception from."""
        self.among, before = among, self.among
        found = self._resolve_parts(list_children(exception), slot)
        self.among = before
        return tuple(name for each in found for name in each.names)

    def resolve_one(
        self, noun: Node, slot: Slot, *, lent: str = "", forbids: bool = False, is_pair: bool = False
    ) -> Named:
        """The objects of one phrase; none where it is open or where there is none."""
        find = getattr(self, f"find_{noun.data}", None)  # `it`, `them`, `others`, `everything`, `everything_else`
        if find is None:
            named = self._find_quantified(noun, slot, lent, forbids=forbids, is_pair=is_pair)
        else:
            named = Named(names=find(noun, slot))
        if noun.data == "everything" and slot is Slot.LOOSE:
            named = replace(named, number=self._count_contents(named.names))
        self.recent[-1] += [name for name in named.names if name not in self.recent[-1]]
        self.grouped.update(named.names if len(named.names) > 1 else ())
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
        """Of several objects those that stand in or on what `from` names; one object is taken from wherever it is."""
        owners = self.resolve_aside(source, Slot.PLACE).names
        if len(objects.names) < 2 or not owners:
            return objects
        names = tuple(each.name for each in self._list_standing(map(self.get, objects.names), owners))
        if not names:
            self.lack(RequestProblemKind.THING, f"{objects.words} from {self.quote(source)}", objects.names)
        return replace(objects, names=names)

    def find_it(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """The one fitting object that the latest clause with any named; with several, the person is asked which."""
        for before in reversed(self.recent[:-1]):
            found = [name for name in before if name not in self.recent[-1] and slot.takes(self.get(name))]
            if found:
                return (found[0],) if len(found) == 1 else self.ask(QuestionKind.WHICH, phrase, found)
        if before := [name for name in self.list_past(is_place=slot is Slot.VESSEL) if slot.takes(self.get(name))]:
            return (before[0],) if len(before) == 1 else self.ask(QuestionKind.WHICH, phrase, before)
        if slot is Slot.OPENS and (doors := [each.name for each in self.list_fitting(slot)]):
            return (doors[0],) if len(doors) == 1 else self.ask(QuestionKind.WHICH, phrase, doors)
        return () if self.questions else self.lack(RequestProblemKind.SENTENCE, phrase)

    def find_corrected(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """The latter of two phrases; the former, which it corrects, lends its noun."""
        wrong, meant = list_children(phrase)
        if head := self.find_head(wrong):
            self.heads[slot] = head
        return self.resolve_one(meant, slot).names

    def find_rather(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """Of `the red cube rather than the blue one` the former; `the cubes into the red tray, not the blue one` is open."""
        is_one = any(has_token(head, "one") for head in list_children(phrase)[1].find_data("head"))
        if slot is Slot.PLACE and is_one and "not" in str(phrase.children[1]) and len(self.recent[-1]) > 1:
            return self.lack(RequestProblemKind.SENTENCE, phrase)
        meant, other = self._resolve_parts(list_children(phrase), slot)
        return tuple(name for name in meant.names if name not in other.names)

    def find_head(self, phrase: Node) -> str:
        """The first noun of the scene in a phrase, empty without one."""
        return next(filter(None, (self._read_head(plain)[0] for plain in phrase.find_data("plain"))), "")

    def find_alternatives(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """The one of `the red or the blue cube` that the person names."""
        names = dict.fromkeys(name for each in self._resolve_parts(list_children(phrase), slot) for name in each.names)
        return self.ask(QuestionKind.WHICH, phrase, names) if len(names) > 1 else tuple(names)

    def find_opening(self, name: str) -> str:
        """What opens of an object: itself, what it is a part of, or its one lid, door or drawer."""
        thing = self.get(name)
        parts = [each.name for each in self.vocabulary.things.values() if each.opens and each.part_of == name]
        found = [name] if thing.opens else [thing.part_of] if thing.part_of else parts
        return found[0] if len(found) == 1 else name

    def list_past(self, *, is_place: bool = False) -> list[str]:
        """Objects that the last goal is about, or their places, as far as they are here."""
        texts = self.vocabulary.past[-1].accept if self.vocabulary.past else ()
        named = dict.fromkeys(name for text in texts for name in find_entities(text)[is_place : is_place + 1])
        return [name for name in named if name in self.vocabulary.things]

    def find_them(self, noun: Node, _: Slot) -> tuple[str, ...]:
        """The movable objects of the latest clause with several; else all that were moved."""
        groups = [tuple(name for name in before if self.get(name).movable) for before in reversed(self.recent[:-1])]
        found = next((group for group in groups if len(group) > 1), tuple(dict.fromkeys(self.moved)))
        found = found or tuple(name for name in self.list_past() if self.get(name).movable)
        return found if len(found) > 1 else self.lack(RequestProblemKind.SENTENCE, noun)

    def find_everything(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        """All that fits; without a slot, all that can be moved or opened."""
        colours = {str(token) for token in noun.children if get_type(token) == "elliptic"}
        fitting = [each for each in self.list_fitting(slot) if slot is not Slot.ANY or each.movable or each.opens]
        found = [thing for thing in fitting if colours <= thing.words]
        for tail in list_children(noun):
            found = self._filter(found, tail)
        return tuple(thing.name for thing in found) or self.lack(RequestProblemKind.THING, noun)

    def find_everything_else(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        """All that fits, and of which nothing was said."""
        before = [each for names in self.recent[:-1] for each in names]
        named = [*self.moved, *self.spared, *before] or self.list_past()
        names = tuple(name for name in self.find_everything(noun, slot) if name not in named)
        return names if named else self.lack(RequestProblemKind.SENTENCE, noun)

    def find_every_one_but(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        """Of `all but the yellow one` all of the noun, else all that fits where these are of one kind."""
        if any(map(is_open, list_children(list_children(noun)[0]))):  # `all but two`
            return self.lack(RequestProblemKind.SENTENCE, noun)
        head = self.find_head(noun) or self._find_earlier(slot)
        found = self.list_called(head, slot)
        names = tuple(each.name for each in found)
        if not head and len({each.kind for each in found}) < len(found) and len({each.kind for each in found}) > 1:
            return self.ask(QuestionKind.HOW_MANY, noun, names)
        return self.remove(names, noun, slot)

    def list_called(self, head: str, slot: Slot) -> list[Thing]:
        """All objects of a noun; without one all that fit."""
        return self._list_alike(head) if head else self.list_fitting(slot)

    def find_others(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        """Those of which nothing was said, of a noun or of the last one."""
        slot = Slot.MOVED if slot is Slot.ANY else slot
        plain, head = find_child(noun, "plain"), self._find_earlier(slot)
        found = self.list_called(head, slot) if plain is None else self._find_candidates(plain, slot, "")[0]
        named = {*self.moved, *self.spared}
        names = tuple(each.name for each in found if each.name not in named) if named else ()
        return names or self.lack(RequestProblemKind.THING, noun, (each.name for each in found))

    def recall(self) -> None:
        """Let `the blue one` be of the nouns of the last goal."""
        for slot in (Slot.MOVED, Slot.PLACE):
            if before := self.list_past(is_place=slot is Slot.PLACE):
                self.heads[slot] = before[-1].split("_")[-1]

    def _resolve_parts(self, parts: Sequence[Node], slot: Slot, **how: bool) -> list[Named]:
        """Each phrase of a list; `the red and the green cube` lends its noun to the first."""
        named = []
        for n, part in enumerate(parts):
            after = (plain for later in parts[n + 1 :] for plain in later.find_data("plain"))
            lent = next(filter(None, (self._read_head(plain)[0] for plain in after)), "")
            named.append(self.resolve_one(part, slot, lent=lent, **how))
        return named

    def _list_alike(self, head: str) -> list[Thing]:
        return [thing for thing in self.vocabulary.things.values() if head in thing.heads]

    def _count_contents(self, names: Iterable[str]) -> int:
        return sum(self.get(name).contents for name in names)

    def _find_quantified(self, noun: Node, slot: Slot, lent: str, *, forbids: bool, is_pair: bool) -> Named:
        *quantities, plain = list_children(noun)
        asked = len(self.questions)
        things, is_plural, by_colour = self._find_candidates(plain, slot, lent)
        found, kind, number, words = tuple(each.name for each in things), "the", 0, self.quote(noun)
        for quantity in quantities:  # one at most
            kind = "the" if is_pair and quantity.data == "both" else str(quantity.data)
            number = read_number(quantity)
            if kind == "all_but":
                whole = self._count_contents(found) if slot is Slot.LOOSE else len(found)
                kind, number = "number", max(whole - number, 0)
            if kind == "half":
                whole = self._count_contents(found) if slot is Slot.LOOSE else len(found)
                kind, number = "some" if whole % 2 else "number", whole // 2
            if has_token(
                quantity, "other"
            ):  # than what was moved; of places, than where the object of this clause stands
                recent = self.recent[-1]
                before = (
                    {self.get(each).stands for each in recent}
                    if slot is Slot.PLACE
                    else {*self.moved, *self.spared, *recent}
                )
                found = tuple(name for name in found if name not in before) if before & {*found} else ()
                is_bare = has_token(find_child(plain, "head") or plain, "one") and len(plain.children) == 1
                found = tuple(name for name in found if name in self.kin or not is_bare or not self.kin)
            if (total := find_child(quantity, "total")) is not None and read_number(total) != len(found):
                return Named(names=self.ask(QuestionKind.HOW_MANY, noun, found))
        if slot is Slot.LOOSE and kind == "exactly":  # what is counted is at least so many
            return Named(names=self.lack(RequestProblemKind.CAPABILITY, noun))
        if slot is Slot.LOOSE and kind == "some":
            return Named(names=self.ask(QuestionKind.HOW_MANY, noun, ()))
        if slot is Slot.LOOSE:
            is_all = kind == "all" and not number
            return Named(names=found, number=self._count_contents(found) if is_all else number)
        found = tuple(name for name in found if name in self.among) or found
        if not found and len(self.questions) == asked:
            self.lack(RequestProblemKind.THING, words, self.vocabulary.things)
        named = Named(names=found, words=words, by_colour=by_colour)
        if kind == "their" and slot is Slot.PLACE and len(found) > 1 and not by_colour:
            self.reasons.append(f"{words}: the one of the same colour")
            named = replace(named, by_colour=True)
        if named.by_colour or not found:
            return named
        counts = {"both": 2, "all": number or len(found), "the_number": number, "some": -1}
        if counts.get(kind, len(found)) != len(found):
            self.ask(QuestionKind.HOW_MANY, noun, found)
            return Named()
        if kind in counts or (forbids and kind == "any"):
            return named
        if kind in {"number", "exactly", "any"}:
            return self._choose(named, max(number, 1), keeps_rest=kind == "exactly")
        every = is_plural or (forbids and not quantities)  # `no crumb` is every one
        if kind == "same" or (len(found) > 1 and not every):
            own = [name for name in found if self._read_head(plain)[0] == name.split("_")[-1]]
            if len(own) == 1 and kind == "the" and len(list_children(plain)) == 1:  # a bench is a table, `table` the one
                return replace(named, names=tuple(own))
            return Named(names=self.ask(QuestionKind.WHICH, noun, found, likely=self._guess(plain, found)))
        return replace(named, only=kind == "only")

    def _choose(self, named: Named, number: int, *, keeps_rest: bool) -> Named:
        """The first of several, where any will do; those that were moved already come last."""
        if number > len(named.names):
            return Named(names=self.lack(RequestProblemKind.THING, named.words, named.names))
        self.kin = named.names
        ordered = sorted(named.names, key=lambda name: name in self.moved)
        names = tuple(name for name in named.names if name in ordered[:number])
        if number < len(named.names):
            self.chosen += names
            self.reasons.append(f"{named.words}: {', '.join(names)}, as any of {', '.join(named.names)} will do")
        return Named(
            names=names,
            rest=named.names if keeps_rest else (),
            spare=tuple(name for name in ordered if name not in names),
        )

    def _find_candidates(self, plain: Node, slot: Slot, lent: str) -> tuple[list[Thing], bool, bool]:
        """Objects that a noun with its words fits, whether it is a plural, and whether each goes by colour."""
        adjectives, unlike = _read_adjectives(plain)
        by_colour = has_token(plain, "matching") or has_token(plain, "of_its_colour")
        head, is_plural, is_generic = self._read_head(plain)
        if slot is Slot.LOOSE and self.is_loose(plain):
            return self.list_fitting(slot), True, False
        if (alike := find_child(plain, "coloured_as")) is not None:  # `the tray of the same colour as the cube`
            other = self._read_head(list_children(alike)[0])[0]
            by_colour = by_colour or (slot is Slot.PLACE and bool(other) and other == self.heads.get(Slot.MOVED))
        before = lent or self._find_earlier(slot)
        is_one_of = bool(lent) or len(self._list_alike(before)) > 1  # `the green one` is no bottle where there is one
        self.heads |= {slot: head} if head else {}
        found = [] if is_generic else self._list_alike(head or (before if is_one_of else ""))
        if not head and not any(adjectives <= thing.words for thing in found):
            found = self.list_fitting(Slot.MOVED if slot is Slot.PLACE and is_generic else slot)
            # `on the big one` means no floor
            found = [each for each in found if adjectives or each.kind not in SURFACES]
            is_any = is_generic and slot is Slot.ANY
            found = [each for each in found if not is_any or each.movable or each.opens]
        found = [each for each in found if adjectives <= each.words and unlike.isdisjoint(each.words)]
        parts = [child for child in list_children(plain) if child.data not in {"head", "ordinal"}]
        ordinal = find_child(plain, "ordinal")
        nth = 1 + ORDINALS.index(str(ordinal.children[0])) if ordinal is not None else 1
        # `the largest cube on the tray` is of those on the tray
        states = [part for part in parts if part.data in read_lexicon()["meanings"]]
        found = [each for each in found if all(self.is_so(each, part) for part in states)]
        parts = [part for part in parts if part not in states and not (by_colour and part.data == "coloured_as")]
        for part in sorted(parts, key=lambda part: part.data not in _OWNED):
            found = self._filter(found, part, nth)
        return found, is_plural and not has_token(plain, "among"), by_colour

    def is_so(self, thing: Thing, state: Node) -> bool:
        """Whether an object is in a state as the scene begins: `the open drawer`, `the empty tray`."""
        is_ajar = state.data == "open"  # so is a drawer that is open by half, too
        form = read_lexicon()["meanings"]["close" if is_ajar else state.data]["form"]
        text = form.format(thing.name, at="inside" if thing.has_interior else "on")
        return self.vocabulary.is_known(text, is_true=not is_ajar)

    def is_loose(self, plain: Node) -> bool:
        """Whether a phrase means nameless contents of vessels."""
        return self._read_head(plain)[0] == LOOSE and not self._list_alike(LOOSE)

    def _find_earlier(self, slot: Slot) -> str:
        """The noun that `the big ones` stands for: the last of the slot, else of another one if several fit."""
        own = self.heads.get(Slot.MOVED if slot is Slot.ANY else slot, "")
        others = (head for head in reversed(self.heads.values()) if sum(map(slot.takes, self._list_alike(head))) > 1)
        return own if len(self._list_alike(own)) > 1 else next(others, own)

    def _guess(self, plain: Node, names: Sequence[str]) -> str:
        """The likeliest of several: `green` alone is the green cube rather than a bottle of green glass."""
        adjectives = _read_adjectives(plain)[0]
        called = [name for name in names if adjectives and adjectives <= {*name.split("_")}]
        return called[0] if len(called) == 1 else ""

    def _select(
        self, found: Sequence[Thing], phrase: Node, kind: str, owner: Thing | None, nth: int = 1
    ) -> list[Thing]:
        """Those that are most so, or on that side of an object; a question where it depends on who looks."""
        views = (self.view,) if self.view else VIEWS.values() if kind in SIDES else (1.0,)
        if kind in _POSITIONS and owner is None and nth == 1 and len(found) == 1:  # `the top shelf` is one of several
            found = [self.get(name) for name in self.ask(QuestionKind.WHICH, phrase, [each.name for each in found])]
        if owner is not None and kind in {*SIDES, "beside", "under"}:
            seen = [list_beside(found, kind, view, owner) for view in views]
        else:
            seen = [list_nth(found, kind, view, nth, owner.at_m if owner is not None else None) for view in views]
        names = seen[0]
        if seen[0] != seen[-1]:
            likely = dict.fromkeys(name for each in seen[::-1] for name in each)
            names = [*self.ask(QuestionKind.WHICH, phrase, likely)]
        return [thing for thing in found if thing.name in names]

    def _read_head(self, plain: Node) -> tuple[str, bool, bool]:
        """The noun of the scene in a phrase, empty without one; whether it is a plural, and whether it is `thing`."""
        head = find_child(plain, "head")
        token = head.children[0] if head is not None else ""
        word = " ".join(str(token).split())
        if get_type(token) != "noun":
            return "", word.endswith(("s", "stuff")), get_type(token) == "thing"
        nouns = self.vocabulary.list_words()[1]
        one = word if word in nouns else next(noun for noun in nouns if pluralise(noun) == word)
        return one, word != one, False

    def _filter(self, found: Iterable[Thing], tail: Node, nth: int = 1) -> list[Thing]:
        """Those that are parts of, or stand in or on, what the tail names, as the scene begins."""
        if tail.data in {"is_so", "is_not_so"}:
            (state,) = list_children(tail)
            return [thing for thing in found if self.is_so(thing, state) is (tail.data == "is_so")]
        if not list_children(tail):  # `on the left`, `largest`
            return self._select(list(found), tail, str(tail.data), None, nth)
        heads = dict(self.heads)
        plains = [part for part in list_children(tail) if part.data == "plain"]
        owners = [owner.name for plain in plains for owner in self._find_candidates(plain, Slot.ANY, "")[0]]
        self.heads = heads
        if tail.data == "not_located":
            found = [*found]
            there = self._list_standing(found, owners)
            return [thing for thing in found if thing not in there]
        if tail.data == "coloured_as":
            colours = {self.get(name).colour for name in owners}
            if len(colours) > 1:
                colours = {self.get(name).colour for name in self.ask(QuestionKind.WHICH, tail, owners)}
            return [thing for thing in found if thing.colour in colours - {""} and thing.name not in owners]
        if tail.data == "being":
            return self._select(list(found), tail, str(list_children(tail)[0].data), None, nth)
        if tail.data == "more":
            (size, _), (owner, *others) = list_children(tail), owners or [""]
            if others or not owner:
                owner = next(iter(self.ask(QuestionKind.WHICH, tail, owners)), "")
            bodies = [each for each in found if owner and each.name != owner]
            return [each for each in bodies if list_most([each, self.get(owner)], str(size.data), 1.0, None) == [each.name]]
        if tail.data == "between":
            ends = [self.get(name) for name in owners]
            if len(ends) != 2:
                return [self.get(name) for name in self.ask(QuestionKind.WHICH, tail, owners)][:0]
            return [each for each in found if each not in ends and lies_between(each, ends)]
        if tail.data not in _OWNED:
            names = owners if len(owners) == 1 else self.ask(QuestionKind.WHICH, tail, owners)
            around = [thing for thing in found if thing.name not in names]
            return self._select(around, tail, str(tail.data), self.get(names[0])) if names else []
        if tail.data == "part_of":
            return [thing for thing in found if thing.part_of in owners]
        return self._list_standing(found, owners)

    def _list_standing(self, found: Iterable[Thing], owners: Iterable[str]) -> list[Thing]:
        """Those that stand in or on any of some objects as the scene begins; where none is said it is the table."""
        owners = [*owners]
        has_surface = any(self.get(name).kind in SURFACES for name in owners)
        regions = [each for each in map(self.get, owners) if each.kind == REGION]
        return [
            thing
            for thing in found
            if thing.stands in owners
            or (not thing.stands and (thing.ground in owners if thing.ground else has_surface))
            or any(is_within(thing, region) for region in regions)
        ]


def _read_adjectives(plain: Node) -> tuple[set[str], set[str]]:
    """Words that an object of a phrase has, and those that it must not have: `that is not yellow`."""
    words = {kind: {str(token) for token in plain.children if get_type(token) == kind} for kind in ("adj", "elliptic")}
    return (
        (words["adj"], words["elliptic"]) if has_token(plain, "untrue") else (words["adj"] | words["elliptic"], set())
    )


def _list_tokens(tree: Node) -> list[Token]:
    """All words of a phrase; its `meta` is lost where a part of it has several readings."""
    return list(tree.scan_values(lambda each: isinstance(each, Token)))


def list_children(tree: Node) -> list[Node]:
    """Parts of a phrase that are phrases."""
    return [child for child in tree.children if isinstance(child, Tree)]


def find_child(tree: Node, rule: str) -> Node | None:
    """The part of a phrase that a rule made, or None."""
    return next((child for child in list_children(tree) if child.data == rule), None)


def read_number(tree: Node) -> int:
    """The number that a phrase itself says, 0 without one."""
    said = next((str(each) for each in tree.children if get_type(each) == "number"), "zero")
    return NUMBERS.index(said) if said in NUMBERS else int(said)


def has_token(tree: Node, terminal: str) -> bool:
    """Whether a phrase itself, not its parts, has a word of some kind."""
    return any(get_type(child) == terminal for child in tree.children)


def is_open(noun: Node) -> bool:
    """Whether a phrase is about any or all of several, so that an exception after it can be of these."""
    return any(find_child(noun, each) is not None for each in ("any", "all", "different", "number", "exactly"))


def find_side(levels: Sequence[Node], side: str) -> set[int]:
    """Which ends of a tower are said to be at a side: 0 the first, -1 the last."""
    return {end for end in (0, -1) if levels and has_token(levels[end], side)}


def get_type(part: object) -> str:
    """The terminal of a word; empty for a phrase."""
    return part.type.lower() if isinstance(part, Token) else ""
