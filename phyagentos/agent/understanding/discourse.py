"""What was said so far, and which objects of the scene a noun with its words fits.

Upstream: phrases. Downstream: noun phrases, which say how many of these are meant. What is open becomes a question with
its candidates, what is not here a lack; a phrase is never taken for the nearest object.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from phyagentos.agent.understanding.bearings import (
    NEARLY_M,
    SIDES,
    VIEWS,
    is_between,
    is_within,
    list_beside,
    list_first,
    list_most,
    list_nth,
)
from phyagentos.agent.understanding.phrases import Node, find_child, get_type, has_token, list_children, list_tokens
from phyagentos.agent.understanding.reading import pluralise
from phyagentos.agent.understanding.understanding import (
    Ambiguous,
    Impossible,
    Question,
    QuestionKind,
    RequestProblem,
    RequestProblemKind,
)
from phyagentos.agent.understanding.vocabulary import (
    LOOSE,
    NO_TOPS,
    REGION,
    SURFACES,
    SceneObject,
    Vocabulary,
    read_lexicon,
)
from phyagentos.errors import find_nearest
from phyagentos.protocol.predicates.predicate import find_entities

_POSITIONS = {*SIDES, "top", "bottom", "middle"}  # words that choose one of several
_OWNED = {"part_of", "located"}  # tails of a noun that name what it belongs to, or is in or on
ORDINALS = ["first", "second", "third", "fourth", "fifth"]


class Slot(StrEnum):
    """What a phrase is needed for; it decides what `it`, `everything` and a bare colour can mean."""

    MOVED = "moved"  # an object that is taken elsewhere
    PLACE = "place"  # where it is put
    OPENS = "opens"  # an object with a joint
    VESSEL = "vessel"  # an object that others can be in
    LOOSE = "loose"  # nameless contents of a vessel, or the vessel
    ANY = "any"

    def takes(self, item: SceneObject) -> bool:
        """Whether an object is fit for it."""
        fits = {"moved": item.movable, "opens": item.opens, "vessel": item.has_interior, "loose": item.contents}
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
        among: Those that a phrase means where several fit: what an exception is of, or where something stands.
        count: How many `the two cubes nearest to the bottle` are, while they are found.
        left_out: Objects that stay where they are, each with what is missing.
        heard: Every object that a phrase was found to fit.
        exempt: What `everything except the bottle` leaves aside.
        picked: What `pick every cube up and put it` takes up, while it says where to.
        view: Whose left and right are meant, as in `VIEWS`; 0 where a request does not say.
        asks: Whether it is a question, which gets no answer back as a candidate.
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
    count: int = 0
    picked: tuple[str, ...] = ()
    left_out: dict[str, str] = field(default_factory=dict)
    heard: set[str] = field(default_factory=set)
    exempt: list[str] = field(default_factory=list)
    view: float = 0.0
    unmet: str = ""
    asks: bool = False

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
        key = f"{words}@{list_tokens(phrase)[0].start_pos}"
        if (answer := self.answers.get(key)) in possible:
            return (str(answer),)
        self.questions.append(Question(kind=kind, key=key, words=words, candidates=possible, likely=likely))
        return ()

    def ask_view(self, phrase: Node) -> float | None:
        """1 where the robot's view is meant, -1 for that of a person who faces it; None and a question where open."""
        return self.view or next((VIEWS[each] for each in self.ask(QuestionKind.VIEW, phrase, VIEWS)), None)

    def quote(self, tree: Node) -> str:
        """The words of a part of the request."""
        tokens = list_tokens(tree)
        return self.text[tokens[0].start_pos : tokens[-1].end_pos]

    def get(self, name: str) -> SceneObject:
        """An object by its name."""
        return self.vocabulary.objects[name]

    def list_fitting(self, slot: Slot) -> list[SceneObject]:
        """Objects that a slot can take, for phrases that say no noun."""
        return [item for item in self.vocabulary.objects.values() if slot.takes(item)]

    def list_rests(self) -> list[SceneObject]:
        """Fixed objects that take others: vessels; else tops of what is no part and no furniture of the scene."""
        fixed = [each for each in self.list_fitting(Slot.PLACE) if not each.movable and each.kind != REGION]
        vessels = [each for each in fixed if each.has_interior]
        return vessels or [each for each in fixed if not (each.opens or each.part_of) and each.kind not in NO_TOPS]

    def list_past(self, *, is_place: bool = False) -> list[str]:
        """Objects that the last goal is about, or their places, as far as they are here."""
        texts = self.vocabulary.past[-1].accept if self.vocabulary.past else ()
        named = dict.fromkeys(name for text in texts for name in find_entities(text)[is_place : is_place + 1])
        return [name for name in named if name in self.vocabulary.objects]

    def recall(self) -> None:
        """Let `the blue one` be of the nouns of the last goal."""
        for slot in (Slot.MOVED, Slot.PLACE):
            if before := self.list_past(is_place=slot is Slot.PLACE):
                self.heads[slot] = before[-1].split("_")[-1]

    def find_head(self, phrase: Node) -> str:
        """The first noun of the scene in a phrase, empty without one."""
        return next(filter(None, (self._read_head(plain)[0] for plain in phrase.find_data("plain"))), "")

    def lack_named(self, plain: Node, words: str | Node) -> tuple[str, ...]:
        """Note that what a phrase means is not here, or in no inventory."""
        is_seen = self.vocabulary.is_unlisted(self._read_head(plain)[0], read_adjectives(plain)[0])
        if is_seen:
            return self.lack(RequestProblemKind.UNLISTED, words)
        return self.lack(RequestProblemKind.OBJECT, words, self.vocabulary.objects)

    def list_called(self, head: str, slot: Slot) -> list[SceneObject]:
        """All objects of a noun; without one all that fit."""
        return self._list_alike(head) if head else self.list_fitting(slot)

    def _list_alike(self, head: str) -> list[SceneObject]:
        return [item for item in self.vocabulary.objects.values() if head in item.heads]

    def _count_contents(self, names: Iterable[str]) -> int:
        return sum(self.get(name).contents for name in names)

    def _find_candidates(self, plain: Node, slot: Slot, lent: str) -> tuple[list[SceneObject], bool, bool]:
        """Objects that a noun with its words fits, whether it is a plural, and whether each goes by colour."""
        adjectives, unlike = read_adjectives(plain)
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
        if not head and not any(adjectives <= item.words for item in found):
            found = self.list_fitting(Slot.MOVED if slot is Slot.PLACE and is_generic else slot)
            # `on the big one` means no floor
            found = [each for each in found if adjectives or each.kind not in SURFACES]
            is_any = is_generic and slot is Slot.ANY
            found = [each for each in found if not is_any or each.movable or each.opens]
        if not head and self.kin and adjectives == {"other"}:  # one of those that a phrase chose from
            return [], False, False
        is_either = has_token(plain, "or") and len(adjectives) > 1
        found = [each for each in found if (adjectives & each.words if is_either else adjectives <= each.words)]
        found = [each for each in found if unlike.isdisjoint(each.words)]
        parts = [child for child in list_children(plain) if child.data not in {"head", "ordinal"}]
        ordinal = find_child(plain, "ordinal")
        nth = 1 + ORDINALS.index(str(ordinal.children[0])) if ordinal is not None else 1
        # `the largest cube on the tray` is of those on the tray
        states = [part for part in parts if part.data in read_lexicon()["meanings"]]
        found = [each for each in found if all(self.is_so(each, part) for part in states)]
        parts = [part for part in parts if part not in states and not (by_colour and part.data == "coloured_as")]
        for part in sorted(parts, key=lambda part: part.data not in _OWNED):
            among, found = found, self._filter(found, part, nth)
            if slot is Slot.PLACE and any(get_type(token) in {"nearest", "farthest"} for token in part.children):
                found = self._ask_origin(plain, among, found, str(part.data))
        if (
            parts and not head and found and self.vocabulary.unlisted
        ):  # `the nearest object` may be none of the inventory
            found = [self.get(name) for name in self.ask(QuestionKind.WHICH, plain, [each.name for each in found])]
        self.heard.update(each.name for each in found)
        return found, is_plural and not has_token(plain, "among"), by_colour

    def _ask_origin(
        self, plain: Node, among: Sequence[SceneObject], found: list[SceneObject], kind: str
    ) -> list[SceneObject]:
        """`the nearest tray` is that of the robot, or of what is put there; a question where these differ."""
        moved = [item for name in self.recent[-1] if (item := self.get(name)).movable]
        among = [each for each in among if each not in moved]
        others = [each for item in moved for each in self._select(among, plain, kind, item)]
        names = dict.fromkeys(each.name for each in (*found, *others))
        if len(names) <= len(found):
            return found
        return [self.get(name) for name in self.ask(QuestionKind.WHICH, plain, names)]

    def is_so(self, item: SceneObject, state: Node) -> bool:
        """Whether an object is in a state as the scene begins: `the open drawer`, `the empty tray`."""
        is_ajar = state.data == "open"  # so is a drawer that is open by half, too
        text = self.say_state(item, "close" if is_ajar else str(state.data))
        return self.vocabulary.is_known(text, is_true=not is_ajar)

    def say_state(self, item: SceneObject, state: str) -> str:
        """The statement that an object is in a state; what holds nameless contents is not empty."""
        if state == "clear" and item.contents:
            return f"not (contains({item.name}))"
        form: str = read_lexicon()["meanings"][state]["form"]
        return form.format(item.name, at="inside" if item.has_interior else "on")

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
        adjectives = read_adjectives(plain)[0]
        called = [name for name in names if adjectives and adjectives <= {*name.split("_")}]
        return called[0] if len(called) == 1 else ""

    def _select(
        self, found: Sequence[SceneObject], phrase: Node, kind: str, owner: SceneObject | None, nth: int = 1
    ) -> list[SceneObject]:
        """Those that are most so, or on that side of an object; a question where it depends on who looks."""
        views = (self.view,) if self.view else tuple(VIEWS.values()) if kind in SIDES else (1.0,)
        if kind in _POSITIONS and owner is None and nth == 1 and len(found) == 1:  # `the top shelf` is one of several
            found = [self.get(name) for name in self.ask(QuestionKind.WHICH, phrase, [each.name for each in found])]
        if owner is not None and kind in {*SIDES, "beside", "under"}:
            seen = [list_beside(found, kind, view, owner) for view in views]
            nearly = list_beside(found, kind, 1.0, owner, NEARLY_M) if kind == "beside" else seen[0]
            if kind == "beside" and not self.asks and not (seen[0] and nearly == seen[0]):
                seen = [[*self.ask(QuestionKind.WHICH, phrase, nearly or (each.name for each in found))]]
        else:
            at_m = owner.at_m if owner is not None else None
            seen = [list_first(found, kind, view, max(self.count, 1), at_m) for view in views]
            seen = [list_nth(found, kind, view, nth, at_m) for view in views] if nth > 1 else seen
        names, called = (
            seen[0],
            [each.name for each in found if owner is None and kind in {*SIDES} & {*each.name.split("_")}],
        )
        if seen[0] != seen[-1] or not {*called} <= {*names}:
            if self.asks:
                view = self.ask_view(phrase)
                return [] if view is None else [item for item in found if item.name in seen[view != views[0]]]
            likely = dict.fromkeys(name for each in (called, *seen[::-1]) for name in each)
            names = [*self.ask(QuestionKind.SIDE, phrase, likely)]
        return [item for item in found if item.name in names]

    def _read_head(self, plain: Node) -> tuple[str, bool, bool]:
        """The noun of the scene in a phrase, empty without one; whether it is a plural, and whether it is `item`."""
        head = find_child(plain, "head")
        token = head.children[0] if head is not None else ""
        word = " ".join(str(token).split())
        if get_type(token) != "noun":
            return "", word.endswith(("s", "stuff")), get_type(token) == "thing"
        nouns = self.vocabulary.list_words()[1]
        one = word if word in nouns else next(noun for noun in nouns if pluralise(noun) == word)
        if one in read_lexicon()["synonyms"][LOOSE] and not self._list_alike(one):
            return LOOSE, word != one, False
        return one, word != one, False

    def _filter(self, found: Iterable[SceneObject], tail: Node, nth: int = 1) -> list[SceneObject]:
        """Those that are parts of, or stand in or on, what the tail names, as the scene begins."""
        if tail.data in {"is_so", "is_not_so"}:
            (state,) = list_children(tail)
            return [item for item in found if self.is_so(item, state) is (tail.data == "is_so")]
        if has_token(tail, "it"):
            return self._filter_by_it([*found], tail)
        if tail.data == "stacked":  # on another one
            return [item for item in found if item.stands and self.get(item.stands).movable]
        if not list_children(tail):  # `on the left`, `largest`
            return self._select(list(found), tail, str(tail.data), None, nth)
        heads = dict(self.heads)
        plains = [part for part in list_children(tail) if part.data == "plain"]
        owners = [owner.name for plain in plains for owner in self._find_candidates(plain, Slot.ANY, "")[0]]
        self.heads = heads
        if tail.data in {*SIDES, "between", "near", "far", "beside"} and self._carries_all(found := [*found], owners):
            return [*map(self.get, self.lack(RequestProblemKind.PART, tail))]  # a spot on it, which no criterion says
        if tail.data == "not_called":
            return [item for item in found if item.name not in owners]
        if tail.data == "not_located":
            there = self._list_standing(found := [*found], owners)
            return [item for item in found if item not in there]
        if tail.data == "coloured_as":
            colours = {self.get(name).colour for name in owners}
            if len(colours) > 1:
                colours = {self.get(name).colour for name in self.ask(QuestionKind.WHICH, tail, owners)}
            return [item for item in found if item.colour in colours - {""} and item.name not in owners]
        if tail.data == "being":
            return self._select(list(found), tail, str(list_children(tail)[0].data), None, nth)
        if tail.data == "more":
            (size, _), (owner, *others) = list_children(tail), owners or [""]
            if others or not owner:
                owner = next(iter(self.ask(QuestionKind.WHICH, tail, owners)), "")
            bodies = [each for each in found if owner and each.name != owner]
            return [
                each for each in bodies if list_most([each, self.get(owner)], str(size.data), 1.0, None) == [each.name]
            ]
        if tail.data == "between":
            return self._filter_between(found, tail, owners)
        if tail.data not in _OWNED:
            names = owners if len(owners) == 1 else self.ask(QuestionKind.WHICH, tail, owners)
            around = [item for item in found if item.name not in names]
            return self._select(around, tail, str(tail.data), self.get(names[0])) if names else []
        if tail.data == "part_of":
            is_surface = any(self.get(name).kind in SURFACES for name in owners)  # `the corner of the table`
            return [item for item in found if item.part_of in owners or (is_surface and item.kind == REGION)]
        return self._list_standing(found, owners)

    def _filter_between(self, found: Iterable[SceneObject], tail: Node, owners: Sequence[str]) -> list[SceneObject]:
        ends = [self.get(name) for name in owners]
        if len(ends) == 1:  # that is no two
            return [*map(self.get, self.lack(RequestProblemKind.SENTENCE, tail))]
        if len(ends) != 2:
            return [self.get(name) for name in self.ask(QuestionKind.WHICH, tail, owners)][:0]
        return [each for each in found if each not in ends and is_between(each, ends)]

    def _carries_all(self, found: Sequence[SceneObject], owners: Sequence[str]) -> bool:
        """Whether all that a tail names is on the only object: `the panel between the buttons`."""
        return bool(owners) and any(
            all(item.name in {self.get(name).part_of, self.get(name).stands} for name in owners) for item in found
        )

    def _filter_by_it(self, found: Sequence[SceneObject], tail: Node) -> list[SceneObject]:
        """`the tray nearest to it`, to what is put there."""
        origins = [item for name in self.recent[-1] if (item := self.get(name)).movable]
        origins = origins or [self.get(name) for name in self.recent[-2:][0]]
        if len(origins) == 1:
            return self._select(found, tail, str(tail.data), origins[0])
        self.ask(QuestionKind.WHICH, tail, (each.name for each in origins))
        return []

    def check_within(self, found: Iterable[SceneObject], place: str) -> None:
        """A lack where the scene has objects at a place that no predicate calls in or on it, as below a board."""
        known = self.vocabulary.is_known
        for item in found:
            texts = f"on({item.name}, {place})", f"inside({item.name}, {place})"
            if place and item.stands == place and all(known(text, is_true=False) for text in texts):
                self.lack(RequestProblemKind.CAPABILITY, f"{item.name} in {place}")

    def _list_standing(self, found: Iterable[SceneObject], owners: Iterable[str]) -> list[SceneObject]:
        """Those that stand in or on any of some objects as the scene begins; where none is said it is the table."""
        owners = [*owners]
        has_surface = any(self.get(name).kind in SURFACES for name in owners)
        regions = [each for each in map(self.get, owners) if each.kind == REGION]
        return [
            item
            for item in found
            if item.stands in owners
            or (not item.stands and (item.ground in owners if item.ground else has_surface))
            or any(is_within(item, region) for region in regions)
        ]


def read_adjectives(plain: Node) -> tuple[set[str], set[str]]:
    """Words that an object of a phrase has, and those that it must not have: `that is not yellow`."""
    words = {kind: {str(token) for token in plain.children if get_type(token) == kind} for kind in ("adj", "elliptic")}
    return (
        (words["adj"], words["elliptic"]) if has_token(plain, "untrue") else (words["adj"] | words["elliptic"], set())
    )
