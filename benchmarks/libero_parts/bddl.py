"""A goal in BDDL becomes a goal graph of this project: wanted effects, and what has to be so before them.

BDDL is the language of BEHAVIOR, in which LIBERO states its tasks. Of a problem only `:goal` is read, and not the
objects of interest. Where cameras have to find out which of several equal objects a name stands for, `:init` is read as
well: the place at which the problem says that it begins. No skill is named here; the selector finds one for each wanted
effect.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import yaml

from phyagentos.errors import DefinitionError, format_names
from phyagentos.protocol.world.environment import Entity

Expression = str | list["Expression"]

_TOKEN = re.compile(r"[()]|[^\s()]+")
TIMEOUT_S = 120.0  # of a session, in the target's time
WALL_S = {"wall_timeout_s": 1800.0, "preflight_s": 900.0, "heartbeat_s": 120.0, "stall_s": 300.0, "think_s": 900.0}
"""Limits by the wall clock: the target's time stands still while anything computes, however slow the machine."""
CENTRED_M = 0.03  # off the middle of what it is put on
TOUCH_M = 0.002  # above a surface: what leans on something else beside it is higher
WIDE = 0.97  # of its travel: what objects are put into is opened so far, though less counts as open


@dataclass(frozen=True, slots=True, kw_only=True)
class Inventory:
    """What the names of a BDDL problem stand for.

    Attributes:
        entities: By name.
        owners: Of each entity, the name of the object that it belongs to.
        rooms: Of each name of a room or surface, the entity that has it.
        regions: Those of these names that are regions, with the height of their floors [m]; another one is the interior
            of its entity.
    """

    entities: Mapping[str, Entity]
    owners: Mapping[str, str] = field(default_factory=dict)
    rooms: Mapping[str, str] = field(default_factory=dict)
    regions: Mapping[str, float] = field(default_factory=dict)

    def find_place(self, name: str) -> str:
        """The entity or region in which, or on which, objects are put; raises `UNKNOWN_NAME`."""
        if name in self.regions or name in self.entities:
            return name
        if name in self.rooms:
            return self.rooms[name]
        raise _explain(name, [*self.entities, *self.rooms])

    def find_mechanism(self, name: str) -> str:
        """The entity with a joint that a name stands for: itself, what has the room, or the one part of an object."""
        if (whole := self.rooms.get(name, name)) in self.entities and self.entities[whole].mechanism is not None:
            return whole
        moving = [key for key, each in self.entities.items() if self.owners.get(key) == name and each.mechanism]
        if len(moving) != 1:
            raise _explain(name, [key for key, each in self.entities.items() if each.mechanism])
        return moving[0]

    def find_parts(self, name: str) -> list[str]:
        """Entities that are fixed to one."""
        return [key for key, each in self.entities.items() if each.part_of == name]


@dataclass(frozen=True, slots=True)
class Effect:
    """A wanted fact of one or two objects.

    Attributes:
        wanted: As a predicate of this project.
        place: Where an object is put; empty for the state of a joint.
        mechanism: What opens or closes; empty where an object is put.
        also: What has to be so with it, for which no skill is sought.
    """

    wanted: str
    place: str = ""
    mechanism: str = ""
    also: tuple[str, ...] = ()

    @property
    def accept(self) -> list[str]:
        """Everything that has to be so."""
        return [self.wanted, *self.also]


def parse_bddl(text: str) -> list[Expression]:
    """The expressions of a text; raises `SYNTAX` where parentheses do not match."""
    stack: list[list[Expression]] = [[]]
    for token in _TOKEN.findall(re.sub(r";[^\n]*", "", text)):
        if token == "(":
            stack.append([])
        elif token == ")" and len(stack) > 1:
            done = stack.pop()
            stack[-1].append(done)
        elif token == ")":
            raise DefinitionError.of("SYNTAX", "goal", "a ')' without its '('", "an expression in parentheses")
        else:
            stack[-1].append(token)
    if len(stack) > 1:
        raise DefinitionError.of("SYNTAX", "goal", f"{len(stack) - 1} '(' without their ')'", "a whole expression")
    return stack[0]


def read_goal(text: str) -> list[list[str]]:
    """The atoms of a problem's `:goal`, in its order: `["on", "a", "b"]`; raises `SYNTAX`."""
    goal = _find_section(parse_bddl(text), ":goal")
    goal = goal[0] if goal is not None and len(goal) == 1 else None
    if goal is None:
        raise DefinitionError.of("SYNTAX", "goal", "no (:goal ...)", "a problem with a goal")
    return list(_iter_atoms(goal))


def read_places(text: str) -> dict[str, str]:
    """Where each object begins: the name of what it is on or in, as `:init` states it."""
    atoms = _find_section(parse_bddl(text), ":init") or []
    return {str(each[1]): str(each[2]) for each in atoms if isinstance(each, list) and _puts(each)}


def _puts(atom: list[Expression]) -> bool:
    return len(atom) == 3 and str(atom[0]).lower() in _PUTS


def _find_section(expressions: Sequence[Expression], name: str) -> list[Expression] | None:
    """What stands in a problem after a keyword."""
    for each in expressions:
        if isinstance(each, list) and each:
            if each[0] == name:
                return each[1:]
            if (found := _find_section(each, name)) is not None:
                return found
    return None


def _iter_atoms(goal: Expression) -> Iterator[list[str]]:
    match goal:
        case [str(head), *parts] if head.lower() == "and":
            for part in parts:
                yield from _iter_atoms(part)
        case [str(head), *terms] if head.lower() in _MEANINGS and all(isinstance(term, str) for term in terms):
            if len(terms) != (arity := 2 if head.lower() in _PUTS else 1):
                raise DefinitionError.of("SYNTAX", "goal", f"{head} of {len(terms)} terms", f"{head} of {arity}")
            yield [head.lower(), *(str(term) for term in terms)]
        case _:
            found = goal if isinstance(goal, str) else " ".join(str(each) for each in goal)
            raise DefinitionError.of("SYNTAX", "goal", f"({found})", f"and, or {format_names(_MEANINGS)}")


def _put_in(inventory: Inventory, item: str, place: str) -> Effect:
    there = inventory.find_place(place)
    return Effect(f"inside({inventory.find_place(item)}, {there})", place=inventory.rooms.get(place, there))


def _put_on(inventory: Inventory, item: str, place: str) -> Effect:
    """On a surface that the world marks is within the space above it, and down on it; on a room is inside it.

    On an object is on it, over its middle.
    """
    there, what = inventory.find_place(place), inventory.find_place(item)
    if place in inventory.regions:
        down = f"height({what}) <= {inventory.regions[place] + TOUCH_M:.4f}"
        return Effect(f"inside({what}, {there})", place=there, also=(down,))
    if place in inventory.rooms:
        return _put_in(inventory, item, place)
    return Effect(f"on({what}, {there})", place=there, also=(f"centred({what}, {there}, {CENTRED_M})",))


def _move(state: str, inventory: Inventory, name: str) -> Effect:
    return Effect(f"{state}({(what := inventory.find_mechanism(name))})", mechanism=what)


_open, _close = partial(_move, "open"), partial(_move, "closed")
Meaning = Callable[..., Effect]
_PUTS: dict[str, Meaning] = {"in": _put_in, "on": _put_on}
_MEANINGS: dict[str, Meaning] = _PUTS | {"open": _open, "close": _close, "turnon": _open, "turnoff": _close}


def translate(text: str, inventory: Inventory) -> list[Effect]:
    """The wanted effects of a problem, in its order; raises `SYNTAX` and `UNKNOWN_NAME`."""
    return [_MEANINGS[head](inventory, *terms) for head, *terms in read_goal(text)]


def generate_graph(
    name: str, objective: str, scene: str, effects: Sequence[Effect], inventory: Inventory, target: str
) -> dict[str, Any]:
    """The goal graph that brings effects about.

    What is put into an object with a joint needs it open before, as wide as it goes, and closed, where that is wanted,
    after. Nothing else is ordered.
    """
    places = sorted({each.place for each in effects} & inventory.entities.keys())
    before = [_open(inventory, place) for place in places if inventory.entities[place].mechanism is not None]
    before = [each for each in before if each.wanted not in {other.wanted for other in effects}]
    steps = [*before, *effects]
    names = {each.wanted: f"step_{index + 1}" for index, each in enumerate(steps)}
    sessions = {}
    for each in steps:
        node: dict[str, Any] = {"skill": {"guarantees": each.wanted}, "target": "robot", "accept": each.accept}
        if after := [names[other.wanted] for other in steps if _comes_before(other, each)]:
            node["after"] = after
        if each.mechanism and len(parts := inventory.find_parts(each.mechanism)) == 1:
            node["with"] = {"handle": parts[0]}
        if each in before and (inventory.entities[each.mechanism].joint or 0.0) < WIDE:
            node["even_if_met"] = True
        sessions[names[each.wanted]] = node
    return {
        "goal": name,
        "objective": objective,
        "scene": scene,
        "targets": {"robot": target},
        "defaults": {"timeout_s": TIMEOUT_S, "max_replans": 3, **WALL_S},
        "sessions": sessions,
        "accept": [each for effect in effects for each in effect.accept],
    }


def format_graph(graph: Mapping[str, Any]) -> str:
    """As a file."""
    return yaml.safe_dump(dict(graph), sort_keys=False, width=120)


def _comes_before(first: Effect, then: Effect) -> bool:
    """What opens comes before what is put there, and that before what closes."""
    if then.place:
        return first.mechanism == then.place and first.wanted.startswith("open(")
    is_closing = then.wanted.startswith("closed(")
    return is_closing and then.mechanism in {first.place, first.mechanism} and first is not then


def _explain(name: str, known: Sequence[str]) -> DefinitionError:
    return DefinitionError.unknown("object", "goal", name, known)
