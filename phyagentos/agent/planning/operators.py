"""Skills as operators: what each needs and guarantees for which arguments, and what it undoes by what it moves.

No skill is known by name. An object that is taken or put somewhere leaves every place it was at; nothing may stand on
it; the hand that does it must be empty, unless the skill begins with the object in it; what hides a place must be open.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from typing import Any

from phyagentos.agent.goals.selector import find_lacks
from phyagentos.agent.planning.goal_facts import list_defaults, list_places, make_fact
from phyagentos.agent.planning.problem import Fact, Operator
from phyagentos.agent.planning.rooms import PlacementPoint, count_room, find_in_lane, is_in_reach, is_taken
from phyagentos.protocol.capabilities.skill_runtimes import ParameterRole, SkillRuntime, find_parameter
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates.library import ArgumentKind, Meaning
from phyagentos.protocol.predicates.meaning import find_definition, list_kinds, read_statement, state
from phyagentos.protocol.predicates.predicate import parse_predicate, substitute
from phyagentos.protocol.predicates.syntax import (
    And,
    Call,
    Formula,
    Name,
    Not,
    Number,
    Or,
    Point,
    Star,
    Variable,
    render,
)
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.free_spot import find_support

Effect = tuple[Call, bool]  # a statement, and whether it is true
_EASY_M = 0.1  # a skill that may miss by so much finds a place
_GRIPPER = "gripper_width"  # the action that a hand is opened and closed by


@dataclass(frozen=True, slots=True, kw_only=True)
class Scope:
    """What arguments may be: objects that can be carried, places and spots where they may go, targets of the goal.

    Attributes:
        wanted: Calls of the goal and its constraints; numbers and postures come from them.
        present: Calls that say where objects are now.
        lids: Place -> what has to be open before it is reached.
        cleared: Facts that are false in the end; no object is put onto what it has to leave.
    """

    world: Environment
    objects: Sequence[str]
    places: Sequence[str]
    spots: Sequence[PlacementPoint]
    wanted: Sequence[Call]
    present: Sequence[Call]
    targets: Mapping[str, TargetProfile]
    lids: Mapping[str, str]
    cleared: frozenset[Fact] = frozenset()


def list_operators(skills: Mapping[str, SkillRuntime], scope: Scope) -> list[Operator]:
    """Every operator; facts that a move undoes are those that any of them, or the goal, names."""
    drafts = [
        draft
        for rank, name in enumerate(sorted(skills))
        for target, profile in scope.targets.items()
        if skills[name].loop is None and not skills[name].recipes  # an agent directs it, or it is planned by amounts
        if not any(find_lacks(skills[name], profile))
        for draft in _iter_drafts(skills[name], target, rank, scope)
    ]
    declared = (call for draft in drafts for call, _ in (*draft.effects, *draft.requires))
    known: dict[str, list[Call]] = {}
    for call in dict.fromkeys(chain(scope.wanted, scope.present, declared)):
        for name in {term.text for term in call.terms if isinstance(term, Name)}:
            known.setdefault(name, []).append(call)
    return [operator for draft in drafts for operator in draft.iter_operators(known)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Draft:
    """A skill with its arguments, as it is declared; methods say what follows from calls `known` of a subject.

    It takes or puts the object that is `moved`, if any, to a `place`, or keeps it in a hand. Of skills that are equal
    otherwise the one of least `rank` is preferred.
    """

    scope: Scope
    skill: SkillRuntime
    target: str
    rank: int
    parameters: Fields
    effects: tuple[Effect, ...]
    requires: tuple[Effect, ...]
    moved: str
    place: str | PlacementPoint

    @property
    def gains(self) -> list[Call]:
        """What is true afterwards."""
        return [call for call, value in self.effects if value]

    def iter_operators(self, known: Mapping[str, Sequence[Call]]) -> Iterator[Operator]:
        """One operator, and another for each hidden place that its object may come out of."""
        if not self._is_exact() or not self._fits():
            return
        lids = self.scope.lids
        declared = {make_fact(call): value for call, value in self.requires}
        requires, changes = self._list_needs(known), self._list_changes(declared, known)
        hidden = self._find_hidden(known)
        yield self._make(dict.fromkeys(hidden, False) | requires | declared, changes)
        for fact, place in hidden.items():
            if place != self.place:
                source = {fact: True, state(Meaning.OPEN, lids[place]): True}
                yield self._make(requires | declared | source, changes, f" out of {place}")

    def _find_hidden(self, known: Mapping[str, Sequence[Call]]) -> dict[Fact, str]:
        """Facts that its object is in a place which a lid hides, and that place."""
        lids = {place: rank for rank, place in enumerate(self.scope.lids)}
        said = {make_fact(call): read_statement(call) for call in known.get(self.moved, ())}
        inside = {
            fact: each.place.text
            for fact, each in said.items()
            if each.meaning is Meaning.INSIDE and each.object == Name(self.moved) and isinstance(each.place, Name)
        }
        return dict(sorted(((f, p) for f, p in inside.items() if p in lids), key=lambda pair: lids[pair[1]]))

    def _list_changes(self, declared: Mapping[Fact, bool], known: Mapping[str, Sequence[Call]]) -> dict[Fact, bool]:
        """Guarantees, and what these undo."""
        changes = {make_fact(call): value for call, value in self.effects}
        for call in self.gains:
            definition = find_definition(call)
            for other in definition.excludes if definition is not None else ():
                changes.setdefault(make_fact(replace(call, name=other)), False)
        if not self.moved:
            return changes
        is_taken = any(map(_is_held, self.gains))
        for call in known.get(self.moved, ()):
            is_kept = is_taken and _is_held(call) and declared.get(make_fact(call))  # another hand holds it, too
            if _is_undone(call, self.moved) and not is_kept:
                changes.setdefault(make_fact(call), False)
        return changes | {state(Meaning.MOVED, self.moved): True}

    def _list_needs(self, known: Mapping[str, Sequence[Call]]) -> dict[Fact, bool]:
        """Preconditions beside those that are declared."""
        world, objects, moved, place = self.scope.world, self.scope.objects, self.moved, self.place
        needs: dict[Fact, bool] = {}
        for call in self.gains:
            said = read_statement(call)
            moving = world.entities.get(said.name_object())
            if moving is not None and moving.mechanism is not None:
                lane = find_in_lane(world, moving.name, objects) if said.meaning is Meaning.OPEN else []
                needs |= {state(Meaning.MOVED, name): True for name in lane} | self._need_clear(moving.name, known)
        if _GRIPPER in self.skill.needs.actions:
            needs |= {make_fact(call): False for call in known.get(self.target, ()) if _is_held(call)}
        if not moved:
            return needs
        gone = [read_statement(call) for call, value in self.effects if not value and call.terms[0] != Name(moved)]
        swept = {
            str(each.place.text) for each in gone if each.meaning is Meaning.INSIDE and isinstance(each.place, Name)
        }
        needs |= {state(Meaning.INSIDE, moved, name): False for name in swept}  # not by what is in there
        in_hands = (call for name in (moved, place) for call in known.get(str(name), ()))
        needs |= {make_fact(call): False for call in in_hands if _is_held(call)} | self._need_clear(moved, known)
        if isinstance(place, PlacementPoint):
            needs |= {state(Meaning.MOVED, name): True for name in place.blockers if name != moved}
        else:
            is_top = place in objects and world.entities[place].interior is None
            needs |= self._need_clear(place, known) if is_top else {}
            needs |= {state(Meaning.OPEN, self.scope.lids[place]): True} if place in self.scope.lids else {}
        is_near = is_in_reach(world, moved, self.scope.targets[self.target])
        return needs if is_near else needs | {state(Meaning.MOVED, moved): True}

    def _need_clear(self, name: str, known: Mapping[str, Sequence[Call]]) -> dict[Fact, bool]:
        """Nothing stands on an object but what is put there."""
        said = ((call, read_statement(call)) for call in known.get(name, ()))
        others = {*self.scope.objects} - {name, self.moved}
        return {make_fact(c): False for c, each in said if each.meaning is Meaning.ON and each.name_object() in others}

    def _is_exact(self) -> bool:
        """Whether a point is met as closely as the goal wants it."""
        offered = [call for call, _ in self.effects if any(isinstance(term, Point) for term in call.terms)]
        pairs = product(offered, self.scope.wanted)
        return all(_get_tolerance(a) <= _get_tolerance(b) for a, b in pairs if make_fact(a) == make_fact(b))

    def _fits(self) -> bool:
        """Whether the place is in reach, and not too small."""
        world, place = self.scope.world, self.place
        if not self.moved or not place:
            return True
        if isinstance(place, PlacementPoint) and (
            state(Meaning.ON, self.moved, place.support) in self.scope.cleared or is_taken(world, self.moved, place)
        ):
            return False
        is_near = is_in_reach(world, place, self.scope.targets[self.target])
        return is_near and (isinstance(place, PlacementPoint) or count_room(world, self.moved, place) > 0)

    def _make(self, requires: Mapping[Fact, bool], changes: Mapping[Fact, bool], source: str = "") -> Operator:
        skill, entities = self.skill, self.scope.world.entities
        at_spot = isinstance(self.place, PlacementPoint)
        is_exact = at_spot and all(_get_tolerance(call) < _EASY_M for call, _ in self.effects)
        kinds = {key: entities[v].kind for key, v in self.parameters.items() if isinstance(v, str) and v in entities}
        is_meant = any(each.kinds or kinds.get(key) == key for key, each in skill.parameters.items())
        support = find_parameter(skill, ParameterRole.SUPPORT)
        burden = len(self.parameters.keys() - {support}) + len(skill.requires)
        burden += 2 * (is_exact + (at_spot and not support) - is_meant)
        present = map(read_statement, self.scope.present)
        is_full = any(each.meaning is Meaning.INSIDE and each.place == Name(self.moved) for each in present)
        burden += 4 * (is_full and not skill.hold)  # a skill that watches it all through spills less
        shown = ", ".join(f"{key}={value}" for key, value in self.parameters.items())
        promise = " and ".join(make_fact(call) if value else f"not {render(call)}" for call, value in self.effects)
        return Operator(
            name=f"{skill.skill}({shown}) on {self.target}{source}",
            skill=skill.skill,
            target=self.target,
            parameters=self.parameters,
            requires=requires,
            changes=changes,
            cost=100 * (20 + burden) + self.rank,
            reason=f"{skill.skill} guarantees {promise}",
        )


def _iter_drafts(skill: SkillRuntime, target: str, rank: int, scope: Scope) -> Iterator[_Draft]:
    offers = [parse_predicate(text, template=True).formula for text in skill.guarantees]
    requires = [each for text in skill.requires for each in _split(parse_predicate(text, template=True).formula)]
    for chosen in product(*(offer.parts if isinstance(offer, Or) else (offer,) for offer in offers)):
        literals = [literal for formula in chosen for literal in _split(formula)]
        related = [read_statement(call) for call, value in literals if value]
        moved = next((each.name_object(Variable) for each in related if each.relates), "")
        is_turned = any(each.meaning is Meaning.UPRIGHT for each in related)
        support = find_parameter(skill, ParameterRole.SUPPORT) if is_turned else ""
        needed = (each for each in requires if read_statement(each[0]).relates)
        choices = _list_choices(skill, [*literals, *needed], moved, target, scope)
        choices |= {support: choices[support] or [""]} if support in choices else {}
        relations = {call.name for call, value in literals if value}
        for values in product(*choices.values()):
            spot = next((value for value in values if isinstance(value, PlacementPoint)), None)
            written = ([round(x, 4) for x in v.point_m] if isinstance(v, PlacementPoint) else v for v in values)
            given = dict(zip(choices, written, strict=True))
            given |= {k: c for k, p in skill.parameters.items() for c in p.choices if chosen and c in relations}
            item = str(given.get(moved, ""))
            here = _find_support(skill, item, spot, {} if support else given, scope)
            is_wanted = support and state(Meaning.ON, item, str(given.get(support))) in map(make_fact, scope.wanted)
            given |= {} if is_wanted else here  # what is turned stays on what it stands on
            effects = () if "" in given.values() else tuple(_iter_bound(literals, given, target, scope))
            if effects and _is_whole(skill, given, scope.world) and len(dict(effects)) == len(set(effects)):
                yield _Draft(
                    scope=scope,
                    skill=skill,
                    target=target,
                    rank=rank,
                    parameters={key: given[key] for key in skill.parameters if key in given},
                    effects=effects,
                    requires=tuple(_iter_bound(requires, given, target, scope)),
                    moved=item,
                    place=spot or _find_place(effects, item),
                )


def _list_choices(
    skill: SkillRuntime, uses: Iterable[Effect], moved: str, target: str, scope: Scope
) -> dict[str, list[Any]]:
    """Values of each parameter that some literals name, and of the parts of what opens or closes."""
    choices: dict[str, list[Any]] = {}
    for call, value in uses:
        for index, (term, kind) in enumerate(zip(call.terms, list_kinds(call), strict=True)):
            if not isinstance(term, Variable) or term.path not in skill.parameters or term.path in choices:
                continue
            if value:
                found = _list_values(skill, term.path, call, index, moved, target, scope)
                choices[term.path] = [each for each in found if each != target or kind is not ArgumentKind.TARGET]
            elif any(isinstance(other, Star) for other in call.terms):  # only where the goal asks for it
                stars = (each for each in scope.wanted if any(isinstance(term, Star) for term in each.terms))
                wanted = (each.terms[index] for each in stars if each.name == call.name)
                choices[term.path] = list(dict.fromkeys(t.text for t in wanted if isinstance(t, Name)))
    if any(parameter.mechanism for parameter in skill.parameters.values()):
        parts = [name for name, each in scope.world.entities.items() if each.part_of]
        free = (key for key, each in skill.parameters.items() if each.type == "entity" and key not in choices)
        support = find_parameter(skill, ParameterRole.SUPPORT)
        choices |= {key: parts for key in free if key != support}
    return choices


def _list_values(
    skill: SkillRuntime, key: str, call: Call, index: int, moved: str, target: str, scope: Scope
) -> list[Any]:
    parameter, kind, entities = skill.parameters[key], list_kinds(call)[index], scope.world.entities
    named = [each.terms[index] for each in scope.wanted if each.name == call.name and len(each.terms) > index]
    if parameter.type == "point":
        return [*scope.spots]
    if parameter.type == "posture":
        postures = scope.targets[target].postures
        return [term.text for term in dict.fromkeys(named) if isinstance(term, Name) and term.text in postures]
    if kind is ArgumentKind.NUMBER:
        numbers = dict.fromkeys(term.value for term in named if isinstance(term, Number))
        is_left_out = any(each.name == call.name and len(each.terms) <= index for each in scope.wanted)
        default = list_defaults(call)[index] if is_left_out else None
        numbers |= {default: None} if default is not None else {}
        return [int(value) if value.is_integer() else value for value in numbers]
    if kind is ArgumentKind.TARGET:
        return [*scope.targets]
    if parameter.mechanism is not None:
        return [n for n, each in entities.items() if each.mechanism and each.mechanism.kind == parameter.mechanism]
    if key == moved:
        values = list(scope.objects)
    elif (said := read_statement(call)).relates:  # a vessel takes objects in, a top bears them, a region both
        held, is_in = ((name, entities.get(name)) for name in scope.places), said.meaning is Meaning.INSIDE
        values = [name for name, each in held if each is None or (each.interior is not None) == is_in]
    else:
        values = list(dict.fromkeys([*scope.objects, *(term.text for term in named if isinstance(term, Name))]))
    kinds = {name: each.kind for name, each in entities.items()} | dict.fromkeys(scope.world.regions, "region")
    return [name for name in values if not parameter.kinds or kinds.get(name) in parameter.kinds]


def _find_support(
    skill: SkillRuntime, item: str, spot: PlacementPoint | None, given: Mapping[str, object], scope: Scope
) -> dict[str, str]:
    """What an object is put on, where the skill asks for it and no guarantee says it: what is there."""
    key = find_parameter(skill, ParameterRole.SUPPORT)
    if not key or key in given:
        return {}
    below = find_support(scope.world, item) if spot is None and item in scope.world.entities else None
    below = None if below is None or below.interior is not None else below  # the floor of a vessel is no top
    name = spot.support if spot is not None else below.name if below is not None else ""
    return {key: name} if name else {}


def _is_whole(skill: SkillRuntime, given: Mapping[str, object], world: Environment) -> bool:
    """Whether every argument is there, each another object, and parts are of the object that is opened or closed."""
    names = [value for value in given.values() if isinstance(value, str)]
    wholes = {given.get(key) for key, parameter in skill.parameters.items() if parameter.mechanism}
    parts = {world.entities[name].part_of for name in names if name in world.entities} - {""}
    return (not wholes or parts <= wholes) and all(k in given for k in skill.needed) and len(names) == len(set(names))


def _iter_bound(literals: Iterable[Effect], given: Mapping[str, object], target: str, scope: Scope) -> Iterator[Effect]:
    """Effects with arguments; those that name an argument which is left out are left out as well."""
    for call, value in literals:
        bound = parse_predicate(substitute(render(call), {**given, "target": target}), template=True)
        formula = bound.rename_targets({"target": target}).formula
        if not isinstance(formula, Call) or bound.variables:
            continue
        is_open = any(isinstance(term, Star) for term in formula.terms)
        for name in (each for each in scope.objects if each not in given.values()) if is_open else ("",):
            terms = (Name(name) if isinstance(term, Star) else term for term in formula.terms)
            yield Call(formula.name, tuple(terms)), value


def _is_undone(call: Call, moved: str) -> bool:
    """Whether a fact is no more once an object was moved: where it was, and what was measured from it."""
    kinds = [kind for term, kind in zip(call.terms, list_kinds(call), strict=True) if term == Name(moved)]
    said = read_statement(call)
    return said.relates and (said.name_object() == moved or ArgumentKind.CONTAINER not in kinds)


def _is_held(call: Call) -> bool:
    return read_statement(call).meaning is Meaning.HOLDING


def _get_tolerance(call: Call) -> float:
    numbers = [term.value for term in call.terms if isinstance(term, Number)]
    return (numbers or [each for each in list_defaults(call) if each is not None] or [0.0])[0]


def _find_place(effects: Iterable[Effect], moved: str) -> str:
    """Where an object is put; empty where it is taken."""
    calls = (call for call, value in effects if value and not _is_held(call))
    about = (call for call in calls if read_statement(call).name_object() == moved)
    return next((term.text for call in about for term in list_places(call) if isinstance(term, Name)), "")


def _split(formula: Formula, value: bool = True) -> Iterator[Effect]:
    match formula:
        case Not(body):
            yield from _split(body, not value)
        case And(parts) if value:
            for part in parts:
                yield from _split(part)
        case Call():
            yield formula, value
