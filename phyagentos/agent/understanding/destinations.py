"""What destinations mean: in or on a place, the place of an object's colour, beside or on a side of another object.

Upstream: noun phrases. Downstream: the clauses and the questions. Each becomes a predicate of an object and its place.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from phyagentos.agent.understanding.bearings import SIDES, VIEWS, find_beside, list_beside, place_beside, shift
from phyagentos.agent.understanding.discourse import Named, Slot
from phyagentos.agent.understanding.nouns import Nouns
from phyagentos.agent.understanding.phrases import Node, find_child, has_token, is_open, list_children
from phyagentos.agent.understanding.steps import Step, get_object, says
from phyagentos.agent.understanding.understanding import QuestionKind, RequestProblemKind
from phyagentos.agent.understanding.vocabulary import SURFACES, SceneObject
from phyagentos.geometry import Vector
from phyagentos.protocol.predicates.library import Meaning

STEPS_M = {
    "5 cm": 0.05,
    "10 cm": 0.1,
    "20 cm": 0.2,
    "30 cm": 0.3,
    "50 cm": 0.5,
}  # to choose from, where no measure is said


@dataclass(slots=True, kw_only=True)
class Destinations(Nouns):
    """What was put where so far.

    Attributes:
        placed: Objects that the latest placement has put.
        stood: Points at which the request has objects stand.
        left: Vessels that the latest clause takes something out of: what `put the others in` means.
    """

    placed: tuple[str, ...] = ()
    stood: dict[str, Vector] = field(default_factory=dict)
    left: tuple[str, ...] = ()
    _said: list[str] = field(default_factory=list)

    def _find_places(self, dest: Node, *, by_colour: bool = False) -> Named:
        """What a destination names; every coloured place with an interior where it says only the colour."""
        match dest.data:
            case "inside_it":
                return Named(names=self.left or self._find_there(dest))
            case "on_top":
                placed = self.placed or self.list_past()
                if len(placed) != 1:
                    self.lack(RequestProblemKind.SENTENCE, dest)
                return Named(names=tuple(placed[:1]))
            case "to_its_colour":
                vessels = (each.name for each in self.list_fitting(Slot.VESSEL) if each.colour and not each.movable)
                return Named(names=tuple(vessels), words=self.quote(dest), by_colour=True)
        noun = list_children(dest)[0]
        count = len(self.questions)
        if noun.data == "it" and dest.data == "into" and self.left:
            return Named(names=self.left)
        if noun.data == "it" and "top" in str(dest.children[0]) and len(self.placed) == 1:
            return Named(names=self.placed)  # what was put down last, not what it was put into
        is_one = any(has_token(head, "one") for head in noun.find_data("head"))
        self._check_bare(noun, dest)
        is_bare = noun.data == "it" or (is_one and not self.heads.get(Slot.PLACE))
        found = self.resolve_one(noun, Slot.VESSEL if dest.data == "into" and is_bare else Slot.PLACE)
        if (
            find_child(dest, "except") is not None
        ):  # `into any tray but the red one`: of several, or it is of the objects
            names = self.remove(found.names, dest, Slot.PLACE, found.spare) if is_open(noun) else ()
            found = replace(found, names=names or self.lack(RequestProblemKind.SENTENCE, dest))
        if dest.data in SIDES and len(found.names) > 1:
            return replace(found, names=self.ask(QuestionKind.WHICH, dest, found.names))
        if not by_colour:
            return found
        names = self.questions[count].candidates if self.questions[count:] else found.names
        del self.questions[count:]  # `into the tray by colour`: which one is said
        return Named(names=names, words=found.words, by_colour=True)

    def _check_bare(self, noun: Node, dest: Node) -> None:
        """`yellow on the blue` after places were named: the blue one of the places, or of what is moved, is open."""
        plains = [each for each in list_children(noun) if each.data == "plain"]
        heads = self.heads.get(Slot.PLACE, ""), self.heads.get(Slot.MOVED, "")
        if len(plains) != 1 or self._read_head(plains[0])[0] or not all(heads) or heads[0] == heads[1]:
            return
        before = dict(self.heads)
        asked = len(self.questions)
        found = [
            {
                each.name
                for each in self._find_candidates(plains[0], Slot.PLACE, head)[0]
                if each.name not in self.recent[-1] and (dest.data != "into" or each.has_interior)
            }
            for head in heads
        ]
        self.heads = before
        del self.questions[asked:]
        if all(found) and found[0].isdisjoint(found[1]):
            chosen = self.ask(QuestionKind.WHICH, noun, sorted(found[0] | found[1]))
            self.heads[Slot.PLACE] = heads[chosen[0] in found[1]] if chosen else heads[0]

    def _find_there(self, dest: Node) -> tuple[str, ...]:
        """The vessel that was named last; where none was, what is fixed, as `the pad`."""
        named = [name for before in self.recent[:-1] for name in before]
        fixed = [name for name in named if not self.get(name).movable]
        has_vessel = any(Slot.VESSEL.takes(self.get(name)) for name in named)
        return tuple(fixed[-1:]) if fixed and not has_vessel else self.find_it(dest, Slot.VESSEL)

    def _find_place(self, name: str, dest: Node, places: Named) -> str:
        """The place of one object; empty where it is open or where there is none."""
        names, kind = places.names, QuestionKind.WHERE
        if places.by_colour:
            colour, kind = self.get(name).colour, QuestionKind.WHICH
            names = tuple(each for each in names if colour and self.get(each).colour == colour)
            if not names:
                self.left_out[name] = f"{colour} one of {places.words!r}" if colour else f"colour for {places.words!r}"
        place = next(iter(names if len(names) < 2 else self.ask(kind, dest, names, about=name)), "")
        if place == name:  # `place it beside it`
            self.lack(RequestProblemKind.CONTRADICTION, dest)
        return place

    def _locate(self, name: str, dest: Node, place: str) -> str:
        if dest.data in SIDES:
            return self._place_beside(name, dest, place)
        if dest.data == "beside":
            return f"near({name}, {place})"
        if dest.data == "under":
            self.lack(RequestProblemKind.CAPABILITY, dest)
        if (dest.data == "into" and self.get(name).stands != place) or (
            dest.data == "inside_it" and self.get(place).has_interior
        ):
            return f"inside({name}, {place})"
        is_on_lid = dest.data not in {"to", "to_its_colour"} and self.get(place).opens
        return f"on({name}, {place})" if is_on_lid else self._relate(name, place)

    def _relate(self, name: str, place: str) -> str:
        return f"{'inside' if self.get(place).has_interior else 'on'}({name}, {place})"

    def _put(self, named: Named) -> tuple[str, ...]:
        """The objects, noted as put somewhere."""
        self.moved += [name for name in named.names if name not in self.moved]
        self.placed = named.names
        return named.names

    def _stand_at(self, name: str, point_m: Vector) -> str:
        self.moved.append(name)
        self.stood[name] = point_m
        return f"at({name}, ({', '.join(f'{each:.3g}' for each in point_m)}), 0.04)"  # as near as skills promise

    def _place_beside(self, name: str, dest: Node, place: str) -> str:
        """At a point on that side of an object, as no predicate says `left of`; empty where that is open or unknown."""
        if self.get(name).at_m is None or self.get(place).at_m is None:
            self.lack(RequestProblemKind.CAPABILITY, dest)
            return ""
        view = self.ask_view(dest)
        owner = self.find_stood(place, dest)
        if owner.kind in SURFACES:  # a part of the table, and not what is beside it
            far = self.ask(QuestionKind.HOW_FAR, dest, STEPS_M)
            at_m = self.get(name).at_m or (0.0, 0.0, 0.0)
            return self._stand_at(name, shift(at_m, str(dest.data), view, STEPS_M[far[0]])) if view and far else ""
        point_m = place_beside(self.get(name), str(dest.data), view, owner) if view else None
        return self._stand_at(name, point_m) if point_m is not None else ""

    def find_stood(self, name: str, phrase: Node) -> SceneObject:
        """An object where the request or the last goal has it; a lack in or on another one, where no point is said."""
        said = [text for text in (*self.list_past_texts(), *self._said) if get_object(text) == name]
        placed = [text for text in said if says(text, Meaning.INSIDE, Meaning.ON, Meaning.AT)]
        if name not in self.stood and placed and not self.vocabulary.is_known(placed[-1], is_true=True):
            self.lack(RequestProblemKind.CAPABILITY, phrase)
        return replace(self.get(name), at_m=self.stood.get(name, self.get(name).at_m))

    def list_past_texts(self) -> Step:
        """What the last goal accepts."""
        return self.vocabulary.past[-1].accept if self.vocabulary.past else ()

    def _stand_beside(self, name: str, dest: Node, place: str) -> str:
        """At a point on the freest side, as no skill guarantees `near`; empty where places are not known."""
        objects = [each for each in self.vocabulary.objects.values() if each.name not in (name, place)]
        others = [replace(each, at_m=self.stood.get(each.name, each.at_m)) for each in objects]
        point_m = find_beside(self.get(name), self.find_stood(place, dest), others)
        bearer = self.get(place).stands
        if bearer and self.get(bearer).has_interior:  # beside it in there, where no skill chooses the point
            self.lack(RequestProblemKind.CAPABILITY, dest)
        if point_m is None or (self.get(place).has_interior and not self.get(place).movable):
            return ""
        self.reasons.append(f"{self.quote(dest)}: on its freest side, as any will do")
        return self._stand_at(name, point_m)

    def _spread(self, names: Sequence[str], dest: Node, places: Named) -> Sequence[str]:
        """One of several objects in each of several places, as any will do."""
        if len(places.names) > len(names) or (len(places.names) < len(names) and any(dest.find_data("different"))):
            return self.lack(RequestProblemKind.OBJECT, places.words, names)
        pairs = [*zip(names, places.names, strict=False)]
        self.chosen += [name for name, _ in pairs if name not in self.chosen]
        self._put(Named(names=tuple(name for name, _ in pairs)))
        return [self._locate(name, dest, place) for name, place in pairs]

    # questions

    def list_alike(self, plain: Node, slot: Slot = Slot.MOVED) -> list[str]:
        """Names of all objects that a phrase fits; of `object` those that fit the slot."""
        if self.is_loose(plain):
            return [*self.lack(RequestProblemKind.CAPABILITY, plain)]
        found = self._find_candidates(plain, slot, "")[0]
        if not found and self.vocabulary.is_unlisted(self._read_head(plain)[0], ()):
            self.lack_named(plain, plain)
        return [each.name for each in found]

    def list_owned(self, plain: Node, owners: Sequence[str]) -> list[str]:
        """Names of all that a phrase fits, and that are parts of some objects, or stand in or on them."""
        found = [] if self.is_loose(plain) else self._find_candidates(plain, Slot.ANY, "")[0]
        standing = self._list_standing(found, owners)
        return [each.name for each in found if each.part_of in owners or each in standing]

    def list_placed(self, names: Iterable[str], dest: Node) -> dict[str, str]:
        """Of each object the statement that it is at a destination, at one of several."""
        places, names = self.find_any_places(dest), [*names]
        for place in places:
            self.check_within(map(self.get, names), place)
        texts = {name: [self._locate(name, dest, place) for place in places if place != name] for name in names}
        return {name: " or ".join(each) for name, each in texts.items() if each}

    def list_holding(self, places: Iterable[str], names: Iterable[str]) -> dict[str, str]:
        """Of each place the statement that objects are in or on it."""
        return {place: " and ".join(self._relate(name, place) for name in names) for place in places}

    def find_any_places(self, dest: Node) -> tuple[str, ...]:
        """The places of a destination: of `in a tray` every one, as neither question nor prohibition chooses one."""
        any_of = [noun for noun in dest.find_data("quantified") if find_child(noun, "any")]
        plains = [plain for noun in any_of for plain in list_children(noun) if plain.data == "plain"]
        return tuple(self.list_alike(plains[0], Slot.PLACE)) if plains else self._find_places(dest).names

    def list_most(self, nouns: Sequence[Node], last: Node) -> list[str]:
        """Names of those that are most so: of a noun, else of all that can be moved."""
        found = self._find_candidates(nouns[0], Slot.MOVED, "")[0] if nouns else self.list_fitting(Slot.MOVED)
        found = self._find_candidates(last, Slot.MOVED, "")[0] if last.data == "plain" else self._filter(found, last)
        if not found and last.data == "plain":  # `what is red?` may be fixed
            found = self._find_candidates(last, Slot.ANY, "")[0]
            found = found or [*map(self.get, self.lack(RequestProblemKind.OBJECT, last))]
        return [each.name for each in found]

    def list_beside(self, names: Iterable[str], dest: Node) -> dict[str, str]:
        """Who looks, and which objects that one sees on a side of another."""
        found, owners = [self.get(name) for name in names], self._find_places(dest).names
        return {
            who: ", ".join(list_beside(found, str(dest.data), view, self.get(owner))) or "nothing"
            for who, view in VIEWS.items()
            for owner in owners
        }
