"""What it means to put, take, swap or pour objects: each becomes predicates of the objects and their places.

Upstream: noun phrases and destinations. Downstream: the clauses. One method a rule of the grammar.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, permutations

from phyagentos.agent.understanding.bearings import SIDES, find_beside, find_between, find_row, list_by_size, shift
from phyagentos.agent.understanding.destinations import STEPS_M, Destinations
from phyagentos.agent.understanding.discourse import Named, Slot
from phyagentos.agent.understanding.phrases import (
    NUMBERS,
    Node,
    find_child,
    get_type,
    has_token,
    is_open,
    list_children,
    read_number,
)
from phyagentos.agent.understanding.steps import Step, get_object, says
from phyagentos.agent.understanding.understanding import QuestionKind, RequestProblemKind
from phyagentos.agent.understanding.vocabulary import REGION, SURFACES, read_lexicon
from phyagentos.geometry import compute_heading, rotate
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.predicate import find_entities

ALONG = 0.9  # cosine of the angle between a side and what slides to it, at least
_ANGLES = {"90 degrees": math.pi / 2, "45 degrees": math.pi / 4, "180 degrees": math.pi}
_TURNS = {"left": 1.0, "right": -1.0, "clockwise": -1.0} | dict.fromkeys(
    ("anticlockwise", "counterclockwise", "counter-clockwise"), 1.0
)
_HEAP_MAX = 5  # objects of a tower whose orders are listed to choose from
SEEN_SHARE = 0.8  # of poured balls that cameras surely count; see skills/pour


@dataclass(slots=True, kw_only=True)
class Transfers(Destinations):
    """What is brought from one place to another."""

    constraints: list[str] = field(default_factory=list)
    _verb: str = ""
    _dest: Node | None = None

    def _read_put(self, clause: Node, placing: Node) -> Step:
        heaps = str(clause.children[0]).startswith(("stack", "pil"))
        if heaps:  # `stack the yellow on the blue` is of one kind
            self.heads.pop(Slot.PLACE, None)
        wanted = self._read_wish_place(placing, *list_children(placing), heaps=heaps)
        self._dest = None if heaps else self._dest  # the next one may go onto this one
        return wanted

    def _read_not_there(self, clause: Node, dest: Node) -> Step:
        """`stack red on blue, but not on green`."""
        if not self.placed:
            return self.lack(RequestProblemKind.SENTENCE, clause)
        places = self.find_any_places(dest)
        self.constraints += [f"not {self._locate(name, dest, place)}" for name in self.placed for place in places]
        return []

    def _read_put_meant(self, clause: Node, wrong: Node, dest: Node, meant: Node) -> Step:
        """`put the soap into the rack, no, the ingot`."""
        self.heads |= {Slot.MOVED: head} if (head := self.find_head(wrong)) else {}
        return self._read_wish_place(clause, meant, dest)

    def _read_placing(self, placing: Node, *parts: Node) -> Step:
        """Without a verb, as in `two cubes into the tray`, it is to put."""
        if self._verb not in {"put", "take"} and len(self.recent) > 1:
            return self.lack(RequestProblemKind.SENTENCE, placing)
        return self._read_wish_place(placing, *parts)

    def _read_wish_place(self, placing: Node, nouns: Node, *more: Node, heaps: bool = False) -> Step:
        self._verb = "put"
        if any(self.is_loose(plain) for plain in nouns.find_data("plain")):  # what has no names is poured
            return self._fill(
                placing, self.resolve(nouns, Slot.LOOSE), self._find_places(list_children(placing)[-1]).names
            )
        # of several places the last is meant: one before it was corrected
        *_, dest = (each for each in more if each.data not in {"source", "except", "unlike"})
        if (ground := find_child(placing, "ground")) is not None:  # `on the table next to the can`
            below = self.resolve_aside(list_children(ground)[0], Slot.PLACE).names
            if dest.data not in {*SIDES, "beside"} or any(self.get(name).kind not in SURFACES for name in below):
                return self.lack(RequestProblemKind.SENTENCE, placing)
        objects = self._resolve_from(nouns, find_child(placing, "source"))
        self.unmet = self.unmet if objects.by_colour else ""
        if (
            find_child(placing, "except") is not None
            and len(objects.names) < 2
            and any(map(is_open, list_children(dest)))
        ):
            return self.lack(RequestProblemKind.SENTENCE, placing)  # `a cube in every tray but the red one`
        names = self.remove(objects.names, placing, Slot.MOVED, objects.spare)
        if objects.spare and any(get_type(each) == "belong" and " " in str(each) for each in placing.children):
            self.ask(QuestionKind.HOW_MANY, nouns, (*names, *objects.spare))  # `any cube can go there`: one, or all
        if placing.data == "wish_place" and objects.only:  # of what is to be there, not of what to put
            rest = (each.name for each in self.list_fitting(Slot.MOVED) if each.name not in names)
            objects = replace(objects, rest=tuple(rest))
        unmet, self._dest = self.unmet, dest
        self.among = tuple(each.name for each in self.list_fitting(Slot.MOVED)) if heaps else ()  # on no tray
        places, self.among = self._find_places(dest, by_colour=has_token(placing, "of_its_colour")), ()
        self.unmet = unmet
        self._put(replace(objects, names=names))
        if heaps and len(names) > 1:
            self.ask(QuestionKind.ORDER, placing, ())
        for each in dest.find_data("different"):
            return self._spread(names, dest, replace(places, names=places.names[: read_number(each) or len(names)]))
        if any(find_child(noun, "all") for noun in list_children(dest)) and objects.spare and len(names) == 1:
            spread = self._spread((*names, *objects.spare), dest, places)
            others = [each for each in objects.rest if each not in self.placed]
            return [*spread, *(f"not {self._locate(each, dest, place)}" for each in others for place in places.names)]
        wanted = []
        for name in names:
            if place := self._find_place(name, dest, places):
                beside = (
                    self._stand_beside(name, dest, place) if dest.data == "beside" and len(names) <= len(SIDES) else ""
                )
                wanted.append(beside or self._locate(name, dest, place))
                wanted += [f"not {self._locate(each, dest, place)}" for each in objects.rest if each not in names]
        if not wanted and self.left_out and places.by_colour:
            return self.lack(RequestProblemKind.OBJECT, "; ".join(self.left_out.values()), places.names)
        return wanted

    def _resolve_from(self, nouns: Node, source: Node | None) -> Named:
        """Objects of a phrase; `the cube from the left bench` is the one that stands there."""
        owners = self._find_source(list_children(source)[0]) if source is not None else ()
        self.among = tuple(each.name for each in self._list_standing(self.list_fitting(Slot.MOVED), owners))
        objects, self.among = self.resolve(nouns, Slot.MOVED), ()
        return objects if source is None else self.restrict(objects, list_children(source)[0], owners)

    def _find_source(self, noun: Node) -> tuple[str, ...]:
        """Of several places that `from the post` can mean those that something stands in or on."""
        self.among = tuple(filter(None, (each.stands or each.ground for each in self.list_fitting(Slot.MOVED))))
        owners, self.among = self.resolve_aside(noun, Slot.PLACE).names, ()
        return owners

    def _read_pick_put(self, clause: Node, nouns: Node, *more: Node) -> Step:
        placing = more[-1]
        picked = self._resolve_from(nouns, find_child(clause, "source")).names
        self.recent.append([])
        self.picked = picked
        wanted = self._read_wish_place(placing, *list_children(placing))
        self.picked = ()
        if {*picked} != {*self.placed}:  # another object is put down: that is no one clause
            self.lack(RequestProblemKind.SENTENCE, nouns)
        return wanted

    def _read_put_together(self, clause: Node, nouns: Node) -> Step:
        """Of two objects the second beside the first."""
        names = self.resolve(nouns, Slot.MOVED).names
        beside = self._stand_beside(names[1], clause, names[0]) if len(names) == 2 else ""
        return [beside] if beside else self.lack(RequestProblemKind.CAPABILITY, clause)

    def _read_row(self, clause: Node, nouns: Node, *order: Node) -> Step:
        """The first stays, the others stand in a row beside it, on the freest side."""
        bodies = [self.get(name) for name in self.resolve(nouns, Slot.MOVED).names]
        if order and order[0].data == "ground":
            (ground,), order = list_children(order[0]), order[1:]
            if any(self.get(name).kind not in SURFACES for name in self.resolve_aside(ground, Slot.PLACE).names):
                return self.lack(RequestProblemKind.CAPABILITY, clause)
        if order:
            return self._read_row_across(clause, [each.name for each in bodies], order)
        others = [each for each in self.list_fitting(Slot.ANY) if each not in bodies and each.kind not in SURFACES]
        points = find_row(bodies, others) if len(bodies) > 1 else None
        if points is None:
            return () if self.questions or self.lacks else self.lack(RequestProblemKind.CAPABILITY, clause)
        self.reasons.append(f"{self.quote(clause)}: from {bodies[0].name} on to the freest side, as any row will do")
        return [self._stand_at(each.name, point_m) for each, point_m in zip(bodies, points, strict=True)]

    def _read_row_across(self, clause: Node, names: Sequence[str], order: Sequence[Node]) -> Step:
        """From one side to the other as listed; the one that leaves the others most room stays."""
        listed = [name for noun in order for name in self.resolve_one(noun, Slot.MOVED).names]
        if sorted(listed) != sorted(names):
            return () if self.questions or self.lacks else self.lack(RequestProblemKind.SENTENCE, clause)
        if (view := self.ask_view(clause)) is None:
            return ()
        bodies = [self.get(name) for name in listed]
        others = [each for each in self.list_fitting(Slot.ANY) if each not in bodies and each.kind not in SURFACES]
        view *= 1.0 if has_token(clause, "left_to_right") else -1.0
        points = find_row(bodies, others, ("right",), view, range(len(bodies)))
        if not points:
            return self.lack(RequestProblemKind.FIT, clause)
        return [self._stand_at(name, point_m) for name, point_m in zip(listed, points, strict=True)]

    def _read_heap(self, clause: Node, objects: Node, *more: Node) -> Step:
        """A tower in the order of sizes, or with some at its ends; a question where that leaves several orders."""
        names = self.resolve(objects, Slot.MOVED).names
        levels, base = [each for each in more if each.data == "level"], [each for each in more if each.data != "level"]
        on = self.resolve_one(base[0], Slot.PLACE).names if base else ()
        if len(names) == 1 and not base and not levels:  # `stack the block`: on another one of its kind
            others = [each for each in self.list_fitting(Slot.MOVED) if each.kind == self.get(names[0]).kind]
            lower = [each.name for each in sorted(others, key=lambda each: bool(each.stands)) if each.name != names[0]]
            return [self._relate(names[0], each) for each in self.ask(QuestionKind.WHERE, clause, lower)]
        rises, sinks = has_token(clause, "largest_first"), has_token(clause, "smallest_first")
        orders = list_by_size([self.get(name) for name in names]) if rises or sinks else []
        orders = [order[:: 1 if rises else -1] for order in orders]
        if levels and len(names) <= _HEAP_MAX:
            orders = [list(order) for order in permutations(names)]
        for level in levels:
            end = self.resolve_one(list_children(level)[0], Slot.MOVED).names
            if not end or not {*end} <= {*names}:
                return self.lack(RequestProblemKind.SENTENCE, level) if end and names else ()
            is_top = has_token(level, "side_top") or has_token(level, "last")
            orders = [order for order in orders if order[-1 if is_top else 0] == end[0]]
        said = {f"from below: {', '.join(order)}": order for order in orders}
        chosen = [*said] if len(said) == 1 else self.ask(QuestionKind.ORDER, clause, said)
        return [self._relate(upper, lower) for each in chosen for lower, upper in pairwise([*on, *said[each]])]

    def find_laden(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """`the coaster with the coin on it`: what it carries stays on it."""
        owner, *load = list_children(phrase)
        names = self.resolve_one(owner, slot).names
        said = [name for each in load for name in self.resolve_aside(each, Slot.MOVED).names]
        carried = [each for each in self.list_fitting(Slot.MOVED) if each.stands and each.stands in names]
        if names and (not carried or not {*said} <= {each.name for each in carried}):
            return self.lack(RequestProblemKind.FIT, phrase)
        self.constraints += [self._relate(each.name, each.stands) for each in carried if not said or each.name in said]
        return names

    def _read_put_between(self, clause: Node, nouns: Node, *ends: Node) -> Step:
        """At the point half-way between two objects, where there is room for one more."""
        names = self.resolve(nouns, Slot.MOVED).names
        owners = [self.find_stood(name, end) for end in ends for name in self.resolve_one(end, Slot.PLACE).names]
        if len(names) != 1 or len(owners) != 2:
            return () if self.questions or self.lacks else self.lack(RequestProblemKind.SENTENCE, clause)
        self.constraints += [
            f"not moved({each.name})" for each in owners if each.movable and each.name not in self.moved
        ]
        point_m = find_between(self.get(names[0]), owners)
        return [self._stand_at(names[0], point_m)] if point_m else self.lack(RequestProblemKind.FIT, clause, ())

    def _read_put_back(self, clause: Node, nouns: Node) -> Step:
        """To where the scene has it at first: what it stands in or on there, else the table."""
        if str(clause.children[0]).startswith(("bring", "fetch", "get")) and str(clause.children[-1]) == "back":
            return self.lack(RequestProblemKind.CAPABILITY, clause)  # to the person, that is
        names = self._put(self.resolve(nouns, Slot.MOVED))
        is_exact = any("where" in str(each) for each in clause.children)
        wanted = [self._put_exactly(name) if is_exact else self._put_back(name) for name in names]
        return wanted if all(wanted) else self.lack(RequestProblemKind.CAPABILITY, clause)

    def _put_exactly(self, name: str) -> str:
        """At the point where it is at first; empty in or on something, as no skill promises it, or unknown."""
        at_m = self.get(name).at_m
        return self._stand_at(name, at_m) if at_m is not None and not self.get(name).stands else ""

    def _put_back(self, name: str) -> str:
        grounds = (each.name for each in self.list_fitting(Slot.PLACE) if each.kind in SURFACES)
        self.check_within([self.get(name)], self.get(name).stands)
        return self._relate(name, self.get(name).stands or self.get(name).ground or next(grounds, ""))

    def _read_put_where(self, clause: Node, nouns: Node, other: Node) -> Step:
        """To where another object is: in or on what bears it; else, where that stays, a question what is meant."""
        self._verb = "put"
        names, owners = self.resolve(nouns, Slot.MOVED).names, self.resolve_one(other, Slot.MOVED).names
        if len(names) != 1 or len(owners) != 1 or names == owners:
            return () if self.questions or self.lacks else self.lack(RequestProblemKind.SENTENCE, clause)
        owner, at_m = self.get(owners[0]), self.get(names[0]).at_m
        if owner.stands:
            self.check_within([owner], owner.stands)
            return [self._relate(name, owner.stands) for name in self._put(Named(names=names))]
        if owner.at_m is None or at_m is None:
            return self.lack(RequestProblemKind.CAPABILITY, clause)
        beside_m = find_beside(self.get(names[0]), owner, [*self.vocabulary.objects.values()])
        points = {"in its place": owner.at_m} | ({"beside it": beside_m} if beside_m is not None else {})
        meant = ("in its place",) if owner.name in self.moved else self.ask(QuestionKind.WHERE, clause, points)
        return [self._stand_at(names[0], (*points[each][:2], at_m[2])) for each in meant]

    def _read_put_away(self, clause: Node, *parts: Node) -> Step:
        """A question where to; where there is a single vessel, into that. No skill hands anything to a person."""
        named = self._find_untidy(clause, *parts)
        standing = (each.name for each in self._list_standing(self.list_fitting(Slot.MOVED), named))
        names = self._put(Named(names=named if all(self.get(name).movable for name in named) else tuple(standing)))
        if named and not names:
            return self.lack(RequestProblemKind.FIXED, clause)
        if any(has_token(clause, each) for each in ("give", "hand_over")):  # `pick up` is in the examples
            return () if self.questions else self.lack(RequestProblemKind.CAPABILITY, clause)
        places = [each.name for each in self.list_rests()]
        is_clear = (
            len(places) == 1
            and self.get(places[0]).has_interior
            and not any(has_token(clause, each) for each in ("bring", "remove"))
            and not any(get_type(each) == "away" and str(each) != "away" for each in clause.children)
            and places[0] not in {self.get(name).stands for name in names}
        )
        single = places if is_clear else []
        chosen = single or self.ask(QuestionKind.WHERE, clause, places)
        self.reasons += [f"{self.quote(clause)}: {name} is all that takes objects here" for name in single]
        return [self._relate(name, place) for place in chosen for name in names]

    def _find_untidy(self, clause: Node, *parts: Node) -> tuple[str, ...]:
        """What a phrase names; without one, or with `them` of which nothing was said, all that can be moved."""
        if parts:
            return self.resolve(parts[0], Slot.ANY).names
        if has_token(clause, "them") and any(self.recent):
            return self.find_them(clause, Slot.MOVED)
        if has_token(clause, "them") and (before := [name for name in self.list_past() if self.get(name).movable]):
            return tuple(before)
        return tuple(each.name for each in self.list_fitting(Slot.MOVED))

    def _read_shift(self, clause: Node, nouns: Node, *sides: Node) -> Step:
        """By a measure to a side: a point, where places are known; up, turns and other measures are no skill's."""
        side = str(sides[0].data) if sides else ""
        if side in SIDES and (sliding := self._slide(nouns, sides[0])):
            return sliding
        names = self.resolve(nouns, Slot.MOVED).names
        if names and not any(self.get(name).movable for name in names):
            has_joint = all(self.get(self.find_opening(name)).opens for name in names)
            kind = RequestProblemKind.MEASURE if has_joint else RequestProblemKind.FIXED
            return () if self.questions else self.lack(kind, clause)
        said = [str(token) for token in clause.children if get_type(token) in {"amount", "unit"}]
        amount = float(NUMBERS.index(said[0]) if said[0] in NUMBERS else said[0]) if said else 0.0
        by_m = amount * read_lexicon()["units_m"].get(said[-1], 0.0) if said else 0.0
        turning = " ".join(str(token) for token in clause.children if get_type(token) == "rotation") or side
        if not turning and said and said[-1] in read_lexicon()["units_rad"] and has_token(clause, "turn"):
            turning = next(iter(self.ask(QuestionKind.READING, clause, ("clockwise", "anticlockwise"))), "")
            if not turning:
                return []
        if turning in _TURNS and (side not in _TURNS or str(clause.children[0]).startswith(("rotat", "spin", "twist"))):
            by_rad = amount * read_lexicon()["units_rad"].get(said[-1], 0.0) if said else 0.0
            return self._turn(clause, names, by_rad, _TURNS[turning])
        fallen = [name for name in names if self.vocabulary.is_known(f"upright({name})", is_true=False)]
        if not said and has_token(clause, "rotation") and names and len(fallen) == len(names):  # `flip the stool over`
            return self._say_upright(names)
        if side in {*SIDES, "toward", "away"} and not said and names:
            by_m = next((STEPS_M[each] for each in self.ask(QuestionKind.HOW_FAR, clause, STEPS_M)), 0.0)
            if not by_m:
                return []
        if side not in {*SIDES, "toward", "away"} or by_m <= 0.04 or any(self.get(name).at_m is None for name in names):
            return self.lack(RequestProblemKind.MEASURE, " ".join(said) or self.quote(clause))
        view = self.ask_view(sides[0]) if side in SIDES else 1.0
        owners = [name for noun in list_children(sides[0]) for name in self.resolve_one(noun, Slot.ANY).names]
        origins = [at_m for name in owners if name not in names and (at_m := self.get(name).at_m)] or [(0.0, 0.0, 0.0)]
        if len(origins) > 1 or len(owners) != len(list_children(sides[0])):
            return () if self.questions or self.lacks else self.lack(RequestProblemKind.SENTENCE, clause)
        places = ((name, self.get(name).at_m) for name in names)
        return [
            self._stand_at(name, shift(at_m, side, view, by_m, origins[0])) for name, at_m in places if at_m and view
        ]

    def _turn(self, clause: Node, names: Sequence[str], by_rad: float, sign: float) -> Step:
        """About the vertical, where each stands."""
        world = self.vocabulary.world
        if names and not by_rad:
            by_rad = next((_ANGLES[each] for each in self.ask(QuestionKind.HOW_FAR, clause, _ANGLES)), 0.0)
        if world is None or not by_rad:
            return () if self.questions else self.lack(RequestProblemKind.MEASURE, clause)
        wanted: list[str] = []
        for name in names:
            pose = world.entities[name].pose
            heading_rad = math.remainder(compute_heading(pose.quaternion_wxyz) + sign * by_rad, math.tau)
            wanted += [f"turned({name}, {heading_rad:.3f})", self._stand_at(name, pose.position_m)]
        return wanted

    def _slide(self, nouns: Node, side: Node) -> Step:
        """To a side, what slides that way is opened or closed; empty for all else."""
        plains, world = list(nouns.find_data("plain")), self.vocabulary.world
        found = self.list_alike(plains[0], Slot.OPENS) if len(plains) == 1 and world is not None else []
        how = world.entities[found[0]].mechanism if world is not None and len(found) == 1 else None
        if how is None or how.kind != "slide" or not (view := self.ask_view(side)):
            return []
        way = rotate(how.closed.quaternion_wxyz, how.axis)
        along = view * sum(a * b for a, b in zip(way, SIDES[str(side.data)], strict=False))
        if abs(along) < ALONG:
            return []
        verb = "open" if along > 0.0 else "close"
        return [read_lexicon()["meanings"][verb]["form"].format(name) for name in self.resolve(nouns, Slot.OPENS).names]

    def _say_upright(self, names: Sequence[str]) -> Step:
        return [read_lexicon()["meanings"]["stand"]["form"].format(name) for name in names]

    def _stand_for(self, name: str, other: str) -> str:
        """At the point of another object, as high as its own size makes it."""
        (x_m, y_m, z_m), item = self.get(other).at_m or (0.0, 0.0, 0.0), self.get(name)
        return self._stand_at(name, (x_m, y_m, z_m - self.get(other).half_m[2] + item.half_m[2]))

    def _read_same_place(self, _: Node, nouns: Node) -> Step:
        """`put the mug on the shelf before the can`: to the one place that was said."""
        places = {find_entities(text)[-1] for text in self._said if says(text, Meaning.INSIDE, Meaning.ON)}
        if self._dest is None or self._verb != "put" or len(places) > 1:
            return self.lack(RequestProblemKind.SENTENCE, nouns)
        return self._read_wish_place(nouns, nouns, self._dest)

    def _read_take(self, clause: Node, nouns: Node, source: Node, *_: Node) -> Step:
        self._verb = "take"
        objects, places = self.resolve(nouns, Slot.MOVED), self.resolve_aside(source, Slot.PLACE)
        objects = self.restrict(objects, source, places.names)
        objects = replace(objects, names=self.remove(objects.names, clause, Slot.MOVED))
        self.left = tuple(name for name in places.names if self.get(name).has_interior)
        if has_token(clause, "away_from") and not self._list_standing(map(self.get, objects.names), places.names):
            return self.lack(RequestProblemKind.CAPABILITY, clause)
        is_all = [each.data for each in list_children(nouns)] == ["everything"]  # that is to clear it
        names = ("*",) if self._put(objects) and is_all else objects.names
        relations = [self._relate(name, place) for name in names for place in places.names]
        if self._are_vacuous(objects.names, places.names):
            return self.lack(RequestProblemKind.OBJECT, clause, objects.names)
        return [f"not {each}" for each in relations]

    def _are_vacuous(self, names: Sequence[str], places: Sequence[str]) -> bool:
        """Whether none of some objects is in or on any of some places, and no request has put them there."""
        is_new = {*names}.isdisjoint((*map(get_object, self._said), *self.list_past()))
        texts = [self._relate(name, place) for name in names for place in places]
        return is_new and bool(texts) and all(self.vocabulary.is_known(text, is_true=False) for text in texts)

    def _read_take_out(self, clause: Node, nouns: Node) -> Step:
        """Out of the vessels that the objects are in."""
        names = self._put(self.resolve(nouns, Slot.MOVED))
        owners = self._find_bearers(names)
        if any(nouns.find_data("everything")):  # of what is in one
            owners = {name: owner for name, owner in owners.items() if owner}
        if not owners or not all(owner and self.get(owner).has_interior for owner in owners.values()):
            return () if self.questions else self.lack(RequestProblemKind.FIT, clause)
        self.left = tuple(dict.fromkeys(owners.values()))
        return [f"not inside({name}, {owner})" for name, owner in owners.items()]

    def _find_bearers(self, names: Iterable[str]) -> dict[str, str]:
        """What objects are in or on, as the last goal, this request or else the scene has it; empty for the ground."""
        said = (*self.list_past_texts(), *self._said)
        past = {get_object(text): find_entities(text)[-1] for text in said if says(text, Meaning.INSIDE, Meaning.ON)}
        return {name: self.get(name).stands or past.get(name, "") for name in names}

    def _read_remove(self, clause: Node, nouns: Node) -> Step:
        """From what the objects stand in or on, where that is no table; else a question where to."""
        names = self.resolve(nouns, Slot.MOVED).names
        if names and all(self.get(name).stands for name in names):
            self.left = tuple({self.get(name).stands: "" for name in names})
            return [f"not {self._relate(name, self.get(name).stands)}" for name in self._put(Named(names=names))]
        return self._read_put_away(clause, nouns)

    def _read_unstack(self, clause: Node, *nouns: Node) -> Step:
        """Of a tower, where no objects are named, all that stand on another."""
        named = [name for each in nouns for name in self.resolve(each, Slot.MOVED).names]
        below = self._find_bearers(named or [each.name for each in self.list_fitting(Slot.MOVED)])
        wanted = [
            f"not {self._relate(name, place)}"
            for name, place in below.items()
            if place and (named or self.get(place).movable)
        ]
        return wanted or self.lack(RequestProblemKind.FIT, clause)

    def _read_clear_except(self, _: Node, place: Node, exception: Node) -> Step:
        """All that stands there, but what is excepted, is to be elsewhere."""
        places = self.resolve_aside(place, Slot.PLACE).names
        spared = self.resolve_except(exception, Slot.ANY)
        self.spared += spared
        standing = self._list_standing(self.list_fitting(Slot.MOVED), places)
        gone = [each.name for each in standing if each.name not in spared]
        return [f"not {self._relate(name, at)}" for at in places for name in gone] or self.lack(
            RequestProblemKind.OBJECT, exception
        )

    def _read_swap(self, clause: Node, nouns: Node, *other: Node) -> Step:
        names = self.resolve(nouns, Slot.MOVED).names
        names += self.resolve_one(other[0], Slot.MOVED).names if other else ()
        places = [self.get(name).stands for name in names]
        for name, place in zip((self.find_stood(name, clause).name for name in names), places, strict=True):
            self.check_within([self.get(name)], place)
        if len(names) == 2 and all(places) and places[0] != places[1]:
            return [self._relate(name, place) for name, place in zip(names, reversed(places), strict=True)]
        if len(names) == 2 and {*names} & {*places}:  # one on the other
            return [self._relate(*(names if names[0] in places else names[::-1]))]
        points = [self.get(name).at_m for name in names]
        if len(names) == 2 and all(points):  # into the place of the other, or to where it stands on the table
            pairs = zip(names, reversed(names), places[::-1], strict=True)
            return [
                self._relate(name, place) if place else self._stand_for(name, other) for name, other, place in pairs
            ]
        return self.lack(RequestProblemKind.FIT, clause)

    def _read_exchange(self, clause: Node, gone: Node, come: Node) -> Step:
        """One object out of what it stands in or on, and another one there."""
        if has_token(clause, "for") and not str(clause.children[0]).startswith(
            ("exchang", "swap", "switch", "trad")
        ):  # substitute B for A
            gone, come = come, gone
        old, new = (self.resolve_one(noun, Slot.MOVED).names for noun in (gone, come))
        if len(old) != 1 or len(new) != 1:
            return () if self.questions or self.lacks else self.lack(RequestProblemKind.SENTENCE, clause)
        if not (place := self.get(old[0]).stands):
            return self.lack(RequestProblemKind.FIT, clause)
        self._put(Named(names=new))
        return [f"not {self._relate(old[0], place)}", self._relate(new[0], place)]

    def _read_wish_gone(self, clause: Node, nouns: Node, source: Node) -> Step:
        return self._read_take(clause, nouns, source)

    def _read_wish_not_there(self, _: Node, nouns: Node, dest: Node) -> Step:
        names, places = self.resolve(nouns, Slot.MOVED, forbids=True).names, self.find_any_places(dest)
        return [f"not {self._locate(name, dest, place)}" for name in names for place in places]

    def _fill(self, clause: Node, poured: Named, receivers: Iterable[str]) -> Step:
        self._verb = "pour"
        held = self.get(poured.names[0]).contents if len(poured.names) == 1 else 0
        if not held and not self.questions:
            self.lack(RequestProblemKind.FIT, clause, (item.name for item in self.list_fitting(Slot.LOOSE)))
        if not poured.number:
            self.reasons.append(f"no number is said: most of {held}, as cameras miss some of a pile")
        return [f"contains({name}, {poured.number or int(SEEN_SHARE * held)})" for name in receivers if held]

    def _find_receivers(self, phrase: Node, *names: str) -> Sequence[str]:
        """The vessel beside that which is emptied, or a question."""
        others = [
            each.name for each in self.list_fitting(Slot.VESSEL) if each.kind != REGION and each.name not in names
        ]
        return others if len(others) == 1 else self.ask(QuestionKind.WHERE, phrase, others)
