"""What must hold all through: what stays as it is, and what must not happen.

Upstream: transfers. Downstream: the clauses. One method a rule of the grammar.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from phyagentos.agent.understanding.bearings import SIDES
from phyagentos.agent.understanding.discourse import Named, Slot
from phyagentos.agent.understanding.phrases import Node, has_token
from phyagentos.agent.understanding.steps import Step
from phyagentos.agent.understanding.transfers import SEEN_SHARE, Transfers
from phyagentos.agent.understanding.understanding import RequestProblemKind
from phyagentos.agent.understanding.vocabulary import read_lexicon

ACTS = ("open", "close", "press", "switch_on", "switch_off")  # verbs of what has a joint


@dataclass(slots=True, kw_only=True)
class Keeping(Transfers):
    """Predicates that must hold all through."""

    def _say(self, rule: str, objects: Node, *, constraint: bool = False) -> Step:
        """What the lexicon says of each object; a part stands for what opens."""
        meaning = read_lexicon()["meanings"][rule]
        constraint = constraint or meaning.get("constraint", False)
        slot = Slot(meaning["slot"])
        texts: list[str] = []
        named = self.resolve(objects, slot, forbids=constraint)
        self.spared += named.names if constraint else ()
        if rule in ACTS and named.rest:  # of `only the red one` the others stay as they are
            self.unmet = ""
            self._keep(f"not moved({name})" for name in named.rest)
        for name in named.names:
            item = self.get(name)
            owner = self.find_opening(name) if slot is Slot.OPENS else name
            if rule == "clear" and item.contents:  # what it holds has no names
                texts += self._fill(objects, Named(names=(name,)), self._find_receivers(objects, name))
                continue
            is_switched = self.get(owner).kind in meaning.get("kinds", (self.get(owner).kind,))
            if not is_switched or (rule == "press" and self.get(owner).opens != "slide"):
                self.lack(RequestProblemKind.FIT, name)
            if rule == "clear":
                self.check_within(self.list_fitting(Slot.MOVED), name)
            texts.append(meaning["form"].format(owner, at="inside" if item.has_interior else "on"))
        return self._keep(texts) if constraint else texts

    def _keep(self, texts: Iterable[str]) -> Step:
        """Predicates that must hold all through, so that none of them is left to come true."""
        self.constraints += [text for text in texts if text not in self.constraints]
        return []

    # what must hold all through

    def _read_keep(self, clause: Node, objects: Node, kept: Node) -> Step:
        if kept.data in read_lexicon()["meanings"]:
            is_end = has_token(clause, "leave") and kept.data in {"open", "close"}  # so it is left, at the end
            return self._say(str(kept.data), objects, constraint=not is_end)
        if any(objects.find_data("only")):  # `only the bottle should stay on the table`
            return self._read_wish_place(Node("wish_place", clause.children), objects, kept)
        names = self.resolve(objects, Slot.ANY).names
        self.spared += names
        self.among = tuple(self.get(name).stands for name in names)
        places, self.among = self._find_places(kept), ()
        if kept.data in SIDES:
            return self.lack(RequestProblemKind.CAPABILITY, kept)
        self.unmet = ""
        found = ((name, self._find_place(name, kept, places)) for name in names)
        return self._keep(self._locate(name, kept, place) for name, place in found if place)

    def _read_keep_out(self, clause: Node, objects: Node, place: Node) -> Step:
        names = self.resolve(objects, Slot.MOVED).names
        places = self.resolve_one(place, Slot.VESSEL if place.data == "it" else Slot.PLACE).names
        return self._keep(f"not {self._relate(name, place)}" for name in names for place in places)

    def _read_never_put(self, clause: Node, objects: Node, dest: Node) -> Step:
        names = self.resolve(objects, Slot.MOVED, forbids=True).names
        places = self.find_any_places(dest)
        if dest.data in SIDES:
            return self.lack(RequestProblemKind.CAPABILITY, dest)
        texts = [f"not {self._locate(name, dest, place)}" for name in names for place in places]
        late = [
            each for each in texts if has_token(clause, "must_not") and self.vocabulary.is_known(each, is_true=False)
        ]
        self._keep(each for each in texts if each not in late)
        return late  # `the cube should not be on the table`, where it is

    def _read_never_use(self, _: Node, objects: Node) -> Step:
        """What can be moved stays where it is, and nothing comes into or onto a place."""
        named = [self.get(name) for name in self.resolve(objects, Slot.ANY, forbids=True).names]
        return self._keep(
            f"not moved({each.name})" if each.movable else f"not {self._relate('*', each.name)}" for each in named
        )

    def _read_never_take(self, clause: Node, objects: Node, *sources: Node) -> Step:
        """It stays in or on what it stands in or on, which a request may name."""
        names = self.resolve(objects, Slot.MOVED, forbids=True).names
        said = [name for source in sources for name in self.resolve_aside(source, Slot.PLACE).names]
        owners = {name: self.get(name).stands for name in names}
        if not all(owner and (not said or owner in said) for owner in owners.values()):
            return self.lack(RequestProblemKind.FIT, clause)
        return self._keep(self._relate(name, owner) for name, owner in owners.items())

    def _read_never_spill(self, clause: Node, *objects: Node) -> Step:
        """What carries stays upright, and all that is in it stays there."""
        if not objects and not self.placed and self._verb == "pour":  # what is poured was in a vessel that tips
            self.unsaid.append(self.quote(clause))
            return []
        spares = not objects or any(objects[0].find_data("everything"))
        named = [self.get(name) for name in (self.placed if spares else self.resolve(objects[0], Slot.LOOSE).names)]
        wanted = []
        for name in filter(None, dict.fromkeys(each.name if each.has_interior else each.stands for each in named)):
            contents = int(SEEN_SHARE * self.get(name).contents)
            self.constraints.append(f"upright({name})")
            wanted += [f"inside({each.name}, {name})" for each in self.list_fitting(Slot.ANY) if each.stands == name]
            wanted += [f"contains({name}, {contents})"] if contents else []
        return wanted or self.lack(RequestProblemKind.FIT, clause)
