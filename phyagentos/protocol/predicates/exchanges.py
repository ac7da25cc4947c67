"""Worlds in which objects that nothing tells apart have each other's names.

The one rule of ambiguity: a predicate has a value only where it has the same one under every such exchange. A goal may
agree that objects are interchangeable: then the believed names are theirs.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import permutations, product
from math import perm, prod
from typing import TypeVar

import msgspec

from phyagentos.protocol.predicates.syntax import Formula, Name, Star, iter_calls
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.environment import Entity, Environment, Region

EXCHANGES_MAX = 720  # of one predicate: all orders of six alike objects

Known = TypeVar("Known", Entity, Region)
Exchange = Mapping[str, str]
"""Name -> the believed name of the body that has it instead."""


def iter_exchanged(formula: Formula, view: View) -> Iterator[tuple[View, tuple[str, ...]]]:
    """Each possible world that differs from the believed one for a formula, and the names that are exchanged in it.

    Raises:
        ValueError: There are more than `EXCHANGES_MAX`.
    """
    groups = [group for group in find_groups(view.now) if _matters(formula, view, group)]
    if not groups:
        return
    count = prod(_count_exchanges(formula, view, group) for group in groups)
    if count > EXCHANGES_MAX:
        raise ValueError(f"{count} ways to name {', '.join(sorted(set().union(*groups)))}")
    for chosen in product(*(_list_exchanges(formula, view, group) for group in groups)):
        now = {name: body for pair in chosen for name, body in pair[0].items()}
        then = {name: body for pair in chosen for name, body in pair[1].items()}
        names = tuple(sorted({name for each in (now, then) for name, body in each.items() if name != body}))
        if names:
            initial = exchange(view.initial, then) if view.initial is not None else None
            yield replace(view, now=exchange(view.now, now), initial=initial), names


def find_agreed(formula: Formula, view: View) -> tuple[str, ...]:
    """Names in a formula that are those of their bodies by agreement alone, sorted."""
    groups = [group for group in find_groups(view.now) if view.interchangeable and _is_agreed(view, group)]
    return tuple(sorted(frozenset().union(*groups) & _find_names(formula)))


def find_groups(world: Environment) -> list[frozenset[str]]:
    """Names that may be exchanged with each other, directly or in chains."""
    groups: list[frozenset[str]] = []
    known: list[Entity | Region] = [*world.entities.values(), *world.regions.values()]
    for each in known:
        if each.alternatives:
            touched = [group for group in groups if group & {each.name, *each.alternatives}]
            groups = [group for group in groups if group not in touched]
            groups.append(frozenset({each.name, *each.alternatives}).union(*touched))
    return groups


def exchange(world: Environment, bodies: Exchange) -> Environment:
    """The same world with other names; a name whose body is not known is not known."""
    return msgspec.structs.replace(
        world, entities=_rename(world.entities, bodies), regions=_rename(world.regions, bodies)
    )


def _rename(known: Mapping[str, Known], bodies: Exchange) -> dict[str, Known]:
    renamed = {name: body for name, body in bodies.items() if body in known}
    stays = {name: each for name, each in known.items() if name not in bodies}
    return stays | {name: msgspec.structs.replace(known[body], name=name) for name, body in renamed.items()}


def _count_exchanges(formula: Formula, view: View, group: frozenset[str]) -> int:
    """How many `_list_exchanges` would give; a dozen alike objects have more than a memory holds."""
    ways = perm(len(group), len(_list_fixed(formula, view, group)))
    return (1 if _is_agreed(view, group) else ways) * (1 if _is_followed(view, group) else ways)


def _list_fixed(formula: Formula, view: View, group: frozenset[str]) -> list[str]:
    """Names of a group whose bodies decide the value of a formula."""
    return sorted(group if _has_star(formula) and not _is_followed(view, group) else group & _find_names(formula))


def _list_exchanges(formula: Formula, view: View, group: frozenset[str]) -> list[tuple[Exchange, Exchange]]:
    """For now and for the initial snapshot: the same exchange where the naming has followed the bodies since."""
    fixed = _list_fixed(formula, view, group)
    ways = [
        _complete(dict(zip(fixed, bodies, strict=True)), group) for bodies in permutations(sorted(group), len(fixed))
    ]
    as_believed = [{name: name for name in group}]
    now = as_believed if _is_agreed(view, group) else ways
    if _is_followed(view, group):
        return [(each, each) for each in now]
    return list(product(now, ways))


def _complete(some: dict[str, str], group: frozenset[str]) -> Exchange:
    """An exchange of the whole group: the other names have the other bodies."""
    names, bodies = sorted(group - some.keys()), group - set(some.values())
    stays = [name for name in names if name in bodies]
    rest = dict(zip((n for n in names if n not in stays), sorted(bodies - set(stays)), strict=True))
    return some | {name: name for name in stays} | rest


def _matters(formula: Formula, view: View, group: frozenset[str]) -> bool:
    """Whether a formula may tell the members apart: it names one, or compares with when they had other names."""
    is_followed = _is_followed(view, group)
    if _is_agreed(view, group) and is_followed:
        return False
    return bool(group & _find_names(formula)) or (_has_star(formula) and not is_followed)


def _is_agreed(view: View, group: frozenset[str]) -> bool:
    return any(group <= set(names) for names in view.interchangeable)


def _is_followed(view: View, group: frozenset[str]) -> bool:
    """Whether the naming is that of the initial snapshot."""
    if view.initial is None:
        return True
    return all(view.now.entities[name].named_at_s <= view.initial.time_s for name in group if name in view.now.entities)


def _find_names(formula: Formula) -> set[str]:
    return {term.text for call in iter_calls(formula) for term in call.terms if isinstance(term, Name)}


def _has_star(formula: Formula) -> bool:
    return any(isinstance(term, Star) for call in iter_calls(formula) for term in call.terms)
