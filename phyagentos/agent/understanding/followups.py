"""What a request says of the last goal: another object or place, undone, the same for another one, all but some.

Upstream: what must hold all through. Downstream: the clauses. One method a rule of the grammar.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from phyagentos.agent.understanding.discourse import Named, Slot
from phyagentos.agent.understanding.keeping import ACTS, Keeping
from phyagentos.agent.understanding.phrases import Node
from phyagentos.agent.understanding.steps import Step, get_object, list_flipped, rename, says
from phyagentos.agent.understanding.understanding import QuestionKind, RequestProblemKind
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.predicate import find_entities


@dataclass(slots=True, kw_only=True)
class FollowUps(Keeping):
    """Predicates of clauses that go on from the last goal.

    Attributes:
        again: Whether the goal before is meant, and objects that this time are excepted.
    """

    again: bool = False
    excepted: list[str] = field(default_factory=list)

    def _read_instead(self, clause: Node, *said: Node) -> Step:
        """The last goal with another object, or another place: `no, the blue one`, `no, into the blue tray`."""
        meant = said[-1]  # what it is not stands before it
        before = self.list_past()
        if not before:
            return self.lack(RequestProblemKind.PAST, clause)
        if any(clause.find_data("only")):
            return self._read_only(meant)
        past = self.vocabulary.past[-1].accept
        if meant.data == "things" and (either := self._find_either(meant)) and not self._find_fixed(meant):
            chosen = either if len(either) == 1 else self.ask(QuestionKind.WHICH, meant, either)
            if not chosen or not self.get(chosen[0]).movable:
                return [self._relate(name, place) for place in chosen for name in self._put(Named(names=tuple(before)))]
        if meant.data == "things" and (place := self._find_fixed(meant)):
            return [self._relate(name, place) for name in self._put(Named(names=tuple(before)))]
        if meant.data != "things":
            places = self._find_places(meant)
            found = ((name, self._find_place(name, meant, places)) for name in before)
            return [self._locate(name, meant, place) for name, place in found if place]
        names = self._resolve_after(before, meant)
        if len(names) != len(before) != 1:  # which of several is another one
            return () if self.questions or self.lacks else self.lack(RequestProblemKind.SENTENCE, clause)
        if len(before) == 1:
            return [rename(text, {before[0]: name}) for name in names for text in past]
        return [rename(text, dict(zip(before, names, strict=True))) for text in past]

    def _find_either(self, objects: Node) -> list[str]:
        """An object and a place that `no, the blue one` may mean, or a place alone; empty where it is an object."""
        plains = list(objects.find_data("plain"))
        if len(plains) != 1 or self._read_head(plains[0])[0]:
            return []
        moved, places = (
            [each.name for each in self._find_candidates(plains[0], Slot.MOVED, head)[0]]
            for head in (self.heads.get(Slot.MOVED, ""), self.heads.get(Slot.PLACE, ""))
        )
        past = self.list_past(is_place=True)
        is_open = bool(moved and places) or (bool(past) and len(places) == 1)
        return [*moved, *places] if is_open and {*moved, *past}.isdisjoint(places) else []

    def _read_turned(self, clause: Node) -> Step:
        """`the other way around`, of one goal about two objects, or of two objects in two places."""
        past = self.vocabulary.past[-1].accept if self.vocabulary.past else ()
        match [find_entities(text) for text in past]:
            case [(one, other)]:
                pass
            case [(first, one), (second, other)] if one != other and {first, second}.isdisjoint((one, other)):
                pass
            case _:
                return self.lack(RequestProblemKind.PAST, clause)
        return [rename(text, {one: other, other: one}) for text in past]

    def _find_fixed(self, objects: Node) -> str:
        """The place that a phrase names, as `the blue tray`; empty where it is about objects that can be moved."""
        plains = list(objects.find_data("plain"))
        names = [] if len(plains) != 1 or self._read_head(plains[0])[0] == "" else self.list_alike(plains[0])
        return names[0] if len(names) == 1 and not (self.get(names[0]).movable or self.get(names[0]).opens) else ""

    def _read_only(self, objects: Node) -> Step:
        """Of the last goal what is about these objects alone: `no, only the red one`."""
        names, self.unmet = self._resolve_after(self.list_past(), objects), ""
        return [text for text in self.vocabulary.past[-1].accept if get_object(text) in names] or self.lack(
            RequestProblemKind.PAST, objects
        )

    def _read_undo(self, clause: Node) -> Step:
        """What the last goal is about, as the scene has it at first."""
        return [back for text in self.list_past_texts() for back in self._undo(text)] or self.lack(
            RequestProblemKind.PAST, clause
        )

    def _undo(self, text: str) -> Step:
        item = self.get(get_object(text))
        back = [each for each in list_flipped(text) if not self.vocabulary.is_known(each, is_true=False)]
        if item.movable and not item.contents and not says(text, Meaning.UPRIGHT):
            back = [self._put_exactly(item.name)]
        return [each for each in back if each] or self.lack(RequestProblemKind.CAPABILITY, text)

    def _resolve_after(self, before: Sequence[str], objects: Node) -> tuple[str, ...]:
        """Objects of a phrase that goes on from the last goal: `the other one` is none of those."""
        self.moved = [*before]
        self.heads[Slot.MOVED] = next(iter(sorted(self.get(before[-1]).heads)))
        return self.resolve(objects, Slot.MOVED).names

    def _read_same_at(self, clause: Node, objects: Node, dest: Node) -> Step:
        """`the same for the green one, but in the blue tray`."""
        before = self.list_past()
        if not self.list_past(is_place=True):
            return self.lack(RequestProblemKind.PAST, clause)
        self.again = True
        names, places = self._put(Named(names=self._resolve_after(before, objects))), self._find_places(dest)
        found = ((name, self._find_place(name, dest, places)) for name in names)
        return [self._locate(name, dest, place) for name, place in found if place]

    def _read_again(self, _: Node, *exceptions: Node) -> Step:
        self.again = True
        self.excepted += [name for each in exceptions for name in self.resolve_except(each, Slot.ANY)]
        return []

    def _read_again_without(self, clause: Node, objects: Node, *_: Node) -> Step:
        """The last goal but for one object; after a verb, as in `press the red button but not the green one`, never."""
        if self._verb in ACTS:
            return self._say("never_open" if self._verb == ACTS[0] else "never_close", objects, constraint=True)
        if self._verb == "put" and self._dest is not None and len(self.placed) == 1 and not self.chosen:
            return self._read_never_put(clause, objects, self._dest)
        if not (before := self.list_past()):
            return self.lack(RequestProblemKind.PAST, clause)
        self.heads[Slot.MOVED] = next(iter(sorted(self.get(before[-1]).heads)))
        names = self.resolve(objects, Slot.MOVED).names
        if not {*names} <= {*before}:
            return self.lack(RequestProblemKind.PAST, clause)
        self.again, self.excepted = True, [*self.excepted, *names]
        return []
