"""What clauses mean: each becomes predicates that shall come true, or that must hold all through.

Upstream: a reading. Downstream: the embedded understander. One method a rule of the grammar; rules that say the same of
each thing stand in the lexicon. Clauses are steps where the request says an order, or where they exclude each other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from phyagentos.agent.understanding.nouns import (
    Discourse,
    Named,
    Node,
    Slot,
    find_child,
    get_type,
    has_token,
    list_children,
)
from phyagentos.agent.understanding.understanding import LackKind, QuestionKind
from phyagentos.agent.understanding.vocabulary import ROLE, Thing, read_lexicon
from phyagentos.protocol.world.predicates import syntax
from phyagentos.protocol.world.predicates.predicate import find_formula

SEEN_SHARE = 0.8  # of poured balls that cameras surely count; see skills/pour
SIDES = ("bottom", "top")
Step = list[str]


@dataclass(slots=True)
class Clauses:
    """Predicates of a plan, collected clause by clause.

    Attributes:
        constraints: What must hold all through.
        left_out: Thing -> the place that it lacks.
        placed: Things that the latest placement has put.
        again: Whether the goal before is meant, and things that this time are excepted.
    """

    said: Discourse
    constraints: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    placed: tuple[str, ...] = ()
    again: bool = False
    excepted: list[str] = field(default_factory=list)
    _verb: str = ""
    _wiped: str = ""

    def read_plan(self, plan: Node) -> list[Step]:
        """The steps of a plan in the order in which they have to come true."""
        parts = list_children(plan)
        read = [self._read_group(part) if part.data == "group" else self._read_clause(part) for part in parts]
        return [step for group in (reversed(read) if plan.data == "reversed" else read) for step in group if step]

    def _read_group(self, group: Node) -> list[Step]:
        """One step, or one a clause where these exclude each other."""
        clauses = [step for clause in list_children(group) for step in self._read_clause(clause)]
        flipped = {_flip(text) for step in clauses[1:] for text in step}
        if any(text in flipped for step in clauses for text in step):
            return clauses
        return [[text for step in clauses for text in step]]

    def _read_clause(self, clause: Node) -> list[Step]:
        if self.said.recent[-1]:
            self.said.recent.append([])
        steps = self._read_steps(clause)
        if self.said.unmet:  # `only`, `exactly` and `of its colour` are understood of what is put somewhere
            self.said.lack(LackKind.SENTENCE, self.said.unmet)
        return steps

    def _read_steps(self, clause: Node) -> list[Step]:
        if clause.data == "state_command":  # `open and close the drawer`
            *acts, things = list_children(clause)
            self._verb = str(acts[-1].data)
            return [self._say(str(act.data), things) for act in acts]
        if clause.data in read_lexicon()["meanings"]:
            return [self._say(str(clause.data), list_children(clause)[0])]
        read: Callable[[Node], list[str]] = getattr(self, f"_read_{clause.data}")
        return [read(clause)]

    def _say(self, rule: str, things: Node, *, constraint: bool = False) -> list[str]:
        """What the lexicon says of each thing; a part stands for what opens."""
        meaning = read_lexicon()["meanings"][rule]
        constraint = constraint or meaning.get("constraint", False)
        slot = Slot(meaning["slot"])
        texts = []
        for name in self.said.resolve(things, slot, forbids=constraint).names:
            thing = self._get(name)
            owner = thing.part_of if slot is Slot.OPENS and not thing.opens and thing.part_of else name
            if rule == "press" and self._get(owner).opens != "slide":
                self.said.lack(LackKind.FIT, name)
            texts.append(meaning["form"].format(owner))
        if not constraint:
            return texts
        self.constraints += [text for text in texts if text not in self.constraints]
        return []

    # placing

    def _read_put(self, clause: Node) -> list[str]:
        self._verb = "put"
        heaps = str(clause.children[0]).startswith("stack")
        return self._place(list_children(clause)[0], heaps=heaps)

    def _read_placing(self, clause: Node) -> list[str]:
        if self._verb != "put" and len(self.said.recent) > 1:
            self.said.lack(LackKind.SENTENCE, self.said.quote(clause))
            return []
        self._verb = "put"  # without a verb, as in `two cubes into the tray`, it is to put
        return self._place(clause)

    def _read_pick_put(self, clause: Node) -> list[str]:
        things, placing = list_children(clause)
        picked = self.said.resolve(things, Slot.MOVED).names
        self.said.recent.append([])
        wanted = self._read_wish_place(placing)
        if {*picked} != {*self.placed}:  # another thing is put down: that is no one clause
            self.said.lack(LackKind.SENTENCE, self.said.quote(things))
        return wanted

    def _read_wish_place(self, clause: Node) -> list[str]:
        self._verb = "put"
        return self._place(clause)

    def _read_elided(self, clause: Node) -> list[str]:
        """`press the green button and then the red one`: the verb is that of the clause before."""
        if self._verb not in {"open", "close", "press"}:
            self.said.lack(LackKind.SENTENCE, self.said.quote(clause))
            return []
        return self._say(self._verb, list_children(clause)[0])

    def _place(self, placing: Node, *, heaps: bool = False) -> list[str]:
        """Each object at its place."""
        things, *more = list_children(placing)
        dest = next(each for each in more if each.data not in {"source", "except"})
        objects = self.said.resolve(things, Slot.MOVED)
        self.said.unmet = self.said.unmet if objects.by_colour else ""
        if (source := find_child(placing, "source")) is not None:
            objects = self.said.restrict(objects, list_children(source)[0])
        exception = find_child(placing, "except")
        names = self.said.remove(objects.names, [exception] if exception is not None else [], Slot.MOVED)
        unmet = self.said.unmet
        places = self._find_places(dest, by_colour=has_token(placing, "of_its_colour"))
        self.said.unmet = unmet
        self.said.moved += [name for name in names if name not in self.said.moved]
        self.placed = names
        if heaps and len(names) > 1:
            self.said.ask(QuestionKind.ORDER, placing, ())
        wanted = []
        for name in names:
            if place := self._find_place(name, dest, places):
                wanted.append(self._locate(name, dest, place))
                wanted += [f"not {self._locate(each, dest, place)}" for each in objects.rest if each not in names]
        if not wanted and self.left_out and places.by_colour:
            self.said.lack(LackKind.THING, "; ".join(self.left_out.values()), places.names)
        return wanted

    def _find_places(self, dest: Node, *, by_colour: bool = False) -> Named:
        """What a destination names; every coloured place with an interior where it says only the colour."""
        words = self.said.quote(dest)
        match dest.data:
            case "inside_it":
                return Named(names=self.said.find_it(dest, Slot.VESSEL))
            case "on_top":
                if len(self.placed) != 1:
                    self.said.lack(LackKind.SENTENCE, words)
                return Named(names=self.placed[:1])
            case "to_its_colour":
                here = self.said.vocabulary.things.values()
                vessels = (each.name for each in here if each.has_interior and each.colour and not each.movable)
                return Named(names=tuple(vessels), words=words, by_colour=True)
        noun = list_children(dest)[0]
        questions = len(self.said.questions)
        found = self.said.resolve_one(noun, Slot.VESSEL if dest.data == "into" and noun.data == "it" else Slot.PLACE)
        if not by_colour:
            return found
        asked = self.said.questions[questions:]  # `into the tray by colour`: which one is said
        del self.said.questions[questions:]
        return Named(names=asked[0].candidates if asked else found.names, words=found.words, by_colour=True)

    def _find_place(self, name: str, dest: Node, places: Named) -> str:
        """The place of one object; empty where it is open or where there is none."""
        names, kind = places.names, QuestionKind.WHERE
        if places.by_colour:
            colour, kind = self._get(name).colour, QuestionKind.WHICH
            names = tuple(each for each in names if colour and self._get(each).colour == colour)
            if not names:
                self.left_out[name] = f"{colour} one of {places.words!r}" if colour else f"colour for {places.words!r}"
        return next(iter(names if len(names) < 2 else self.said.ask(kind, dest, names, about=name)), "")

    def _locate(self, name: str, dest: Node, place: str) -> str:
        """The predicate that says that a thing is at a place."""
        if dest.data == "beside":
            return f"near({name}, {place})"
        where = self._get(place)
        is_deep = where.has_interior and (not where.opens or dest.data in {"to", "to_its_colour"})
        return f"{'inside' if is_deep or dest.data in {'into', 'inside_it'} else 'on'}({name}, {place})"

    def _relate(self, name: str, place: str) -> str:
        return f"{'inside' if self._get(place).has_interior else 'on'}({name}, {place})"

    # doing other things

    def _read_take(self, clause: Node) -> list[str]:
        things, source = list_children(clause)
        objects = self.said.restrict(self.said.resolve(things, Slot.MOVED), source)
        places = self.said.resolve_aside(source, Slot.PLACE)
        self.said.moved += objects.names
        self.placed = objects.names
        return [f"not {self._relate(name, place)}" for name in objects.names for place in places.names]

    def _read_unstack(self, clause: Node) -> list[str]:
        names = self.said.resolve(list_children(clause)[0], Slot.MOVED).names
        below = ((name, self._get(name).stands) for name in names)
        wanted = [f"not on({name}, {place})" for name, place in below if place and self._get(place).movable]
        if not wanted:
            self.said.lack(LackKind.FIT, self.said.quote(clause))
        return wanted

    def _read_pick(self, clause: Node) -> list[str]:
        self.placed = self.said.resolve(list_children(clause)[0], Slot.MOVED).names
        lifts = {name for name in self.placed if has_token(clause, "lift") and self._get(name).opens == "hinge"}
        return [f"open({name})" if name in lifts else f"holding({ROLE}, {name})" for name in self.placed]

    def _read_pour(self, clause: Node) -> list[str]:
        things, source = find_child(clause, "things"), find_child(clause, "source")
        poured = self.said.resolve(things, Slot.LOOSE) if things is not None else Named()
        sources = self.said.resolve_one(list_children(source)[0], Slot.VESSEL).names if source else poured.names
        into = next(each for each in list_children(clause) if each.data not in {"things", "source"})
        receivers = self.said.resolve_one(into, Slot.VESSEL).names
        held = self._get(sources[0]).contents if len(sources) == 1 else 0
        if not held:
            vessels = (name for name, thing in self.said.vocabulary.things.items() if thing.contents)
            self.said.lack(LackKind.FIT, self.said.quote(clause), vessels)
        if not poured.number:
            self.said.reasons.append(f"no number is said: most of {held}, as cameras miss some of a pile")
        return [f"contains({name}, {poured.number or int(SEEN_SHARE * held)})" for name in receivers if held]

    def _read_clear(self, clause: Node) -> list[str]:
        names = self.said.resolve(find_child(clause, "things") or list_children(clause)[-1], Slot.VESSEL).names
        return [f"not {self._relate('*', name)}" for name in names]

    def _read_wipe(self, clause: Node) -> list[str]:
        things, *tools = list_children(clause)
        for tool in tools:  # a goal says what is clean then, and not with what
            self.said.resolve_one(tool, Slot.MOVED)
            self.said.unsaid.append(f"with {self.said.quote(tool)}")
        names = self.said.resolve(things, Slot.VESSEL).names
        if any(not self._get(name).is_region for name in names):
            regions = [name for name, thing in self.said.vocabulary.things.items() if thing.is_region]
            names = self.said.ask(QuestionKind.WHICH, things, regions)
        self._wiped = names[0] if len(names) == 1 else ""
        return [f"not inside(*, {name})" for name in names]

    def _read_tower(self, clause: Node) -> list[str]:
        levels = [child for child in list_children(clause) if child.data == "level"]
        base = next((child for child in list_children(clause) if child.data != "level"), None)
        on = self.said.resolve_one(base, Slot.PLACE).names if base is not None else ()
        named = [self.said.resolve_one(list_children(level)[0], Slot.MOVED).names for level in levels]
        names = [each[0] for each in named if len(each) == 1]
        last = len(levels) - 1
        at = {side: [n for n in {0, last} if has_token(levels[n], f"side_{side}")] if levels else [] for side in SIDES}
        rises = has_token(clause, "from_bottom") or 0 in at["bottom"] or last in at["top"]
        is_chain = has_token(clause, "onto") and base is None  # `red on green on blue`
        sinks = is_chain or has_token(clause, "from_top") or 0 in at["top"] or last in at["bottom"]
        if rises is sinks:
            orders = [f"from below: {', '.join(each)}" for each in (names, names[::-1])] if names else []
            answer = self.said.ask(QuestionKind.ORDER, clause, orders)
            sinks = answer == tuple(orders[1:])
            names = names if answer else []
        names = names[::-1] if sinks else names
        self.placed = tuple(names[-1:])
        steps = pairwise([*on, *names]) if len(named) == len(names) else ()
        return [self._relate(upper, lower) for lower, upper in steps]

    def _read_heap(self, clause: Node) -> list[str]:
        self.said.resolve(list_children(clause)[0], Slot.MOVED)
        self.said.ask(QuestionKind.ORDER, clause, ())
        return []

    def _read_swap(self, clause: Node) -> list[str]:
        things, *other = list_children(clause)
        names = self.said.resolve(things, Slot.MOVED).names
        names += self.said.resolve_one(other[0], Slot.MOVED).names if other else ()
        places = [self._get(name).stands for name in names]
        if len(names) != 2 or not all(places) or places[0] == places[1]:
            for name in (name for name, place in zip(names, places, strict=True) if not place):
                self.said.lack(LackKind.THING, f"a name for the place of {name}")
            if len(names) != 2 or all(places):
                self.said.lack(LackKind.FIT, self.said.quote(clause))
            return []
        return [self._relate(name, place) for name, place in zip(names, reversed(places), strict=True)]

    def _read_pose(self, clause: Node) -> list[str]:
        posture = next(str(token) for token in clause.children if get_type(token) == "posture")
        return [f"in_posture({ROLE}, {'_'.join(posture.split())})"]

    def _read_again(self, clause: Node) -> list[str]:
        self.again = True
        self.excepted += [name for each in list_children(clause) for name in self.said.resolve_except(each, Slot.ANY)]
        return []

    # states that are wished for, or reached

    def _read_wish_state(self, clause: Node) -> list[str]:
        things, state = list_children(clause)
        if state.data == "is_empty":
            return self._read_clear(clause)
        return self._say(str(state.data), things)

    def _read_wish_contains(self, clause: Node) -> list[str]:
        one, other = list_children(clause)
        vessel, loose = (other, one) if has_token(clause, "there") else (one, other)
        names = self.said.resolve_one(vessel, Slot.VESSEL).names
        if not (number := self.said.resolve_one(loose, Slot.LOOSE).number):
            self.said.ask(QuestionKind.HOW_MANY, loose, ())
        return [f"contains({name}, {number})" for name in names]

    def _read_emptied(self, clause: Node) -> list[str]:
        gone, *places = list_children(clause)
        things = self.said.resolve_one(gone, Slot.MOVED, forbids=True).names
        where = self.said.resolve_one(places[0], Slot.PLACE).names if places else (self._wiped,) * bool(self._wiped)
        if not where:
            self.said.lack(LackKind.SENTENCE, self.said.quote(clause))
        return [f"not {self._relate(name, at)}" for at in where for name in things]

    def _read_until(self, clause: Node) -> list[str]:
        command, condition = list_children(clause)
        done = [text for step in self._read_clause(command) for text in step]
        until = [text for step in self._read_clause(condition) for text in step]
        said = {_get_subject(text) for text in until if text.startswith("contains(")}
        return [*(text for text in done if not text.startswith("contains(") or _get_subject(text) not in said), *until]

    # what must hold all through

    def _read_keep(self, clause: Node) -> list[str]:
        things, kept = list_children(clause)
        if kept.data in read_lexicon()["meanings"]:
            is_end = has_token(clause, "leave") and kept.data in {"is_open", "is_closed"}  # so it is left, at the end
            return self._say(str(kept.data), things, constraint=not is_end)
        names = self.said.resolve(things, Slot.ANY).names
        places = self._find_places(kept)
        self.said.unmet = ""
        found = ((name, self._find_place(name, kept, places)) for name in names)
        self.constraints += [self._locate(name, kept, place) for name, place in found if place]
        return []

    def _read_never(self, clause: Node) -> list[str]:
        return [text for step in self._read_clause(list_children(clause)[0]) for text in step]

    def _read_never_put(self, clause: Node) -> list[str]:
        things, dest = list_children(clause)
        names = self.said.resolve(things, Slot.MOVED, forbids=True).names
        places = self._find_places(dest).names
        self.constraints += [f"not {self._locate(name, dest, place)}" for name in names for place in places]
        return []

    def _read_never_spill(self, clause: Node) -> list[str]:
        """What carries stays upright, and all that is in it stays there."""
        here, things = self.said.vocabulary.things, find_child(clause, "things")
        spares = things is None or any(things.find_data("everything"))
        named = self.placed if things is None or spares else self.said.resolve(things, Slot.LOOSE).names
        vessels = dict.fromkeys(name if here[name].has_interior else here[name].stands for name in named)
        wanted = []
        for name in filter(None, vessels):
            self.constraints.append(f"upright({name})")
            wanted += [f"inside({each.name}, {name})" for each in here.values() if each.stands == name]
            wanted += [f"contains({name}, {here[name].contents})"] if here[name].contents else []
        if not wanted:
            self.said.lack(LackKind.FIT, self.said.quote(clause))
        return wanted

    def _get(self, name: str) -> Thing:
        return self.said.vocabulary.things[name]


def finish(steps: Sequence[Step]) -> tuple[tuple[tuple[str, ...], ...], tuple[str, ...]]:
    """Steps before the last, and what must be true at the end: the last one, and of the others what it leaves true."""
    lasting: dict[str, None] = {}
    put = [{_get_subject(text) for text in step if _is_place(text)} for step in steps]
    cleaned = []
    for n, step in enumerate(steps):
        later = set().union(*put[n:])  # to pick up, or to take out, is a part of putting down
        drops = {"holding(": later, "not inside(": put[n], "not on(": put[n]}
        kept = dict.fromkeys(
            text for text in step if not any(text.startswith(k) and _get_subject(text) in v for k, v in drops.items())
        )
        passing = ("holding(", "docked(", "in_posture(", "visible(")
        gone = {text for text in lasting if _is_place(text) and _get_subject(text) in put[n] and text not in kept}
        gone |= {text for text in lasting if _flip(text) in kept or text.startswith(passing)}
        lasting = {text: None for text in lasting if text not in gone} | kept
        cleaned.append(tuple(kept))
    return tuple(step for step in cleaned[:-1] if step), tuple(lasting)


def _is_place(text: str) -> bool:
    return text.startswith(("inside(", "on("))


def _get_subject(text: str) -> str:
    """The thing that a predicate is about: its first argument, the second of what a robot does with it."""
    formula = find_formula(text)
    formula = formula.body if isinstance(formula, syntax.Not) else formula
    terms = formula.terms if isinstance(formula, syntax.Call) else ()
    return next((term.text for term in terms if isinstance(term, syntax.Name) and term.text != ROLE), "")


def _flip(text: str) -> str:
    """The state of a joint that excludes this one."""
    name, _, rest = text.partition("(")
    other = {"open": "closed", "closed": "open"}.get(name)
    return f"{other}({rest}" if other else ""
