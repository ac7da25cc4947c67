"""What the steps of a plan leave true, and what their predicates are about.

Upstream: the clauses. Downstream: the goal of a request.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from phyagentos.agent.understanding.understanding import list_opposites
from phyagentos.protocol.predicates.library import ArgumentKind, Meaning
from phyagentos.protocol.predicates.meaning import list_kinds, read_statement
from phyagentos.protocol.predicates.predicate import find_entities, find_formula
from phyagentos.protocol.predicates.syntax import Call, Not, render

_PUT = (Meaning.INSIDE, Meaning.ON)
_BROUGHT = (*_PUT, Meaning.AT)
Step = Sequence[str]


def finish(steps: Sequence[Step]) -> tuple[tuple[tuple[str, ...], ...], tuple[str, ...]]:
    """Steps before the last, and what must be true at the end: the last one, and of the others what it leaves true."""
    lasting: dict[str, None] = {}
    put = [{get_object(text) for text in step if says(text, *_BROUGHT)} for step in steps]
    cleaned = []
    for n, step in enumerate(steps):
        later = set().union(*put[n:])  # to pick up, or to take out, is a part of putting down
        taken = {text for text in step if says(text, Meaning.HOLDING) and get_object(text) in later}
        taken |= {text for text in step if says(text, *_PUT, is_true=False) and get_object(text) in put[n]}
        kept = dict.fromkeys(text for text in step if text not in taken)
        past = lasting
        gone = {text for text in lasting if says(text, *_BROUGHT) and get_object(text) in put[n] and text not in kept}
        gone |= {text for text in lasting if _passes(text) or not kept.keys().isdisjoint(list_flipped(text))}
        gone |= {negate(text) for text in kept}
        lasting = {text: None for text in lasting if text not in gone} | kept
        if not kept.keys() <= past.keys():
            cleaned.append(tuple(kept))
    return tuple(step for step in cleaned[:-1] if step), tuple(lasting)


def says(text: str, *meanings: Meaning, is_true: bool = True) -> bool:
    """Whether a text says one of these of its object, or that it is not so."""
    formula = find_formula(text)
    body = formula.body if isinstance(formula, Not) else formula
    return isinstance(formula, Not) is not is_true and read_statement(body).meaning in meanings


def says_place(text: str) -> bool:
    """Whether a text says where an object is, or is not."""
    return any(says(text, *_BROUGHT, is_true=is_true) for is_true in (True, False))


def get_object(text: str) -> str:
    """What a predicate is about, the first object that it names."""
    return next(iter(find_entities(text)), "")


def negate(text: str) -> str:
    """The contrary of a text."""
    return text.removeprefix("not ") if text.startswith("not ") else f"not {text}"


def rename(text: str, names: Mapping[str, str]) -> str:
    """A text about other objects."""
    return re.sub(r"[A-Za-z_]\w*", lambda found: names.get(found[0], found[0]), text)


def _passes(text: str) -> bool:
    """Whether it is about the robot, or what a look shows: no step has to leave that true."""
    formula = find_formula(text)
    is_of_robot = isinstance(formula, Call) and list_kinds(formula)[:1] == (ArgumentKind.TARGET,)
    return is_of_robot or says(text, Meaning.VISIBLE)


def list_flipped(text: str) -> list[str]:
    """States of the same object that exclude this one."""
    formula = find_formula(text)
    return (
        [render(replace(formula, name=name)) for name in list_opposites(formula)] if isinstance(formula, Call) else []
    )
