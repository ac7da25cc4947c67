"""Checks of a wanted goal: names, what things are fit for, what skills bring about, contradictions.

The same for both understanders: what a model writes passes no easier than what the grammar makes.
"""

from collections.abc import Iterator, Mapping, Sequence

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.understanding.understanding import Lack, LackKind
from phyagentos.agent.understanding.vocabulary import ROLE, Vocabulary, iter_literals
from phyagentos.errors import DefinitionError, find_nearest
from phyagentos.protocol.world.predicates import syntax
from phyagentos.protocol.world.predicates.library import ArgumentKind
from phyagentos.protocol.world.predicates.predicate import Predicate, parse_predicate

_Literal = tuple[bool, syntax.Call]  # whether it is to be true
_PLACES = ("inside", "on", "at")  # a thing is at one of each kind
_OPPOSITES = {"open": "closed", "closed": "open", "upright": "fallen", "fallen": "upright"}
_MOVERS = frozenset({*_PLACES, "near", "holding", "open", "closed", "upright"})  # what comes true by moving a thing


_DEMANDS: Mapping[str, tuple[tuple[int, str], ...]] = {  # argument -> what is to be true of the thing
    "inside": ((0, "movable"), (1, "has_interior")),
    "holding": ((1, "movable"),),
    "open": ((0, "opens"),),
    "closed": ((0, "opens"),),
    "contains": ((0, "has_interior"),),
} | dict.fromkeys(("on", "at", "near", "upright"), ((0, "movable"),))


def find_lacks(goal: WantedGoal, vocabulary: Vocabulary) -> tuple[Lack, ...]:
    """Everything about a goal that cannot be met here; empty where it can be planned."""
    parsed: dict[str, Predicate] = {}
    lacks: list[Lack] = []
    for text in (*goal.constraints, *(text for step in goal.steps for text in step), *goal.accept):
        try:
            parsed[text] = parse_predicate(text)
        except DefinitionError as error:
            lacks += [Lack(kind=LackKind.SENTENCE, words=str(problem)) for problem in error.problems]
    for text, predicate in parsed.items():
        lacks += _find_unknown(predicate, goal, vocabulary)
        if not lacks:
            calls = syntax.iter_calls(predicate.formula)
            lacks += [lack for call in calls for lack in _find_unfit(call, vocabulary)]
        if text not in goal.constraints:
            lacks += _find_incapable(predicate.formula, vocabulary)
    if lacks:
        return tuple(dict.fromkeys(lacks))
    constraints = [parsed[text].formula for text in goal.constraints]
    groups = [[parsed[text].formula for text in step] for step in (*goal.steps, goal.accept)]
    clashes = [pair for group in groups for pair in _iter_clashes(group, constraints)]
    return tuple(Lack(kind=LackKind.CONTRADICTION, words=pair) for pair in dict.fromkeys(clashes))


def _find_unknown(predicate: Predicate, goal: WantedGoal, vocabulary: Vocabulary) -> Iterator[Lack]:
    """Names that are not of this scene."""
    for reference in predicate.iter_references():
        is_target = reference.kind is ArgumentKind.TARGET
        known = (*goal.targets, *vocabulary.targets, "target", ROLE) if is_target else tuple(vocabulary.things)
        if reference.name not in known:
            near = find_nearest(reference.name, known) or ""
            yield Lack(kind=LackKind.THING, words=reference.name, nearest=near, possible=known)


def _find_unfit(call: syntax.Call, vocabulary: Vocabulary) -> Iterator[Lack]:
    """Things of a predicate that cannot be used so, with those that can."""
    for index, fact in _DEMANDS.get(call.name, ()):
        term = call.terms[index] if index < len(call.terms) else None
        if isinstance(term, syntax.Name) and not getattr(vocabulary.things[term.text], fact):
            possible = tuple(name for name, thing in vocabulary.things.items() if getattr(thing, fact))
            yield Lack(kind=LackKind.FIT, words=syntax.render(call), possible=possible)
    names = [term.text for term in call.terms if isinstance(term, syntax.Name)]
    if len(names) != len(set(names)):
        yield Lack(kind=LackKind.CONTRADICTION, words=syntax.render(call))
    most = sum(thing.contents for thing in vocabulary.things.values())
    if call.name == "contains" and any(isinstance(term, syntax.Number) and term.value > most for term in call.terms):
        yield Lack(kind=LackKind.FIT, words=syntax.render(call), possible=(str(most),))


def _find_incapable(formula: syntax.Formula, vocabulary: Vocabulary) -> Iterator[Lack]:
    """Literals that no skill brings about. To end a place is to bring the thing to another."""
    able = vocabulary.capabilities
    for is_true, call in iter_literals(formula):
        name = call.name if is_true else f"not {call.name}"
        is_ended = not is_true and call.name in _PLACES and any(each in able for each in _PLACES)
        is_flipped = not is_true and _OPPOSITES.get(call.name) in able
        if name not in able and not is_ended and not is_flipped and name != "not moved":
            yield Lack(kind=LackKind.CAPABILITY, words=name, possible=tuple(able))


def _iter_clashes(group: Sequence[syntax.Formula], constraints: Sequence[syntax.Formula]) -> Iterator[str]:
    """Pairs of conditions that cannot hold together."""
    wanted, always = (  # of a disjunction no part need hold
        [literal for formula in formulas if not isinstance(formula, syntax.Or) for literal in iter_literals(formula)]
        for formulas in (group, constraints)
    )
    for index, one in enumerate(wanted):
        for other in (*wanted[index + 1 :], *always):
            if _excludes(one, other) or _excludes(other, one):
                yield f"{_render(one)} and {_render(other)}"


def _excludes(one: _Literal, other: _Literal) -> bool:
    """Whether two conditions exclude each other, as far as their names alone say."""
    (is_true, call), (is_other_true, second) = one, other
    if call == second:
        return is_true is not is_other_true
    if call.name == second.name == "on" and call.terms == second.terms[::-1]:
        return is_true and is_other_true
    if call.terms[:1] == second.terms[:1] and is_true and is_other_true:
        return second.name == _OPPOSITES.get(call.name) or (call.name == second.name and call.name in _PLACES)
    keeps = second.name == "moved" and not is_other_true
    moves = call.name in _MOVERS and (is_true or call.name in _PLACES)
    return keeps and moves and call.terms[1 if call.name == "holding" else 0] == second.terms[0]


def _render(literal: _Literal) -> str:
    is_true, call = literal
    return syntax.render(call if is_true else syntax.Not(call))
