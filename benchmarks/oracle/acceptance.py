"""Whether what a case asks is met in a recorded world, by the best naming of objects that stand for each other."""

import re
from collections.abc import Iterator, Sequence
from itertools import permutations, product
from pathlib import Path

import numpy as np

from benchmarks.oracle.moment import Moment, read_model, read_state
from benchmarks.oracle.predicates import Box, Judge
from benchmarks.worlds.cases import Case
from benchmarks.worlds.rooms import Room

Agreed = tuple[tuple[str, ...], ...]
"""Groups of things that stand for each other."""


def open_judge(
    room: Room, bundle: Path, before: Path | None = None, broken: frozenset[str] = frozenset(), at: str = "terminal"
) -> Judge:
    """A recorded session at its end, or `initial`; `moved` counts from its beginning, or another bundle's."""
    model = read_model(bundle)
    paths = (bundle / f"{at}.npz", (before or bundle) / "initial.npz")
    now, begun = (Moment(model, read_state(path)) for path in paths)
    return Judge(*list_places(room), now, begun, broken)


def list_places(room: Room) -> tuple[dict[str, Box], dict[str, Box]]:
    """Interiors and regions of a room."""
    inner = {name: item.form.interior for name, item in room.objects.items() if item.form.interior}
    spots = {name: (spot.center_m, spot.half_m) for name, spot in room.spots.items()}
    interiors, regions = ({k: (np.array(a), np.array(b)) for k, (a, b) in each.items()} for each in (inner, spots))
    return interiors, regions


def judge_end(case: Case, last: Path, first: Path) -> tuple[str, tuple[str, ...]]:
    """The truth of a goal's own acceptance, and what decided against it: from its last bundle, and its first."""
    asked = case.accept + tuple(text for text in case.constraints if "moved" not in text)
    return decide(open_judge(case.room, last, first, find_broken(case)), asked, case.interchangeable)


def find_broken(case: Case) -> frozenset[str]:
    """Cameras that are not to be believed."""
    return frozenset(str(fault["camera"]) for fault in case.faults if "camera" in fault)


def decide(judge: Judge, accept: Sequence[str], agreed: Agreed = ()) -> tuple[str, tuple[str, ...]]:
    """`met`, `unmet` or `open`, with what decided against it; no truth where nothing is asked.

    Objects that the goal lets stand for each other are named as is best for what is asked, all of it at once.
    """
    if not accept:
        return "", ()
    values = max(iter_named(judge, accept, agreed), key=lambda values: min(values.values()))
    least = min(values.values())
    truth = "met" if least >= 1 else "unmet" if least <= -1 else "open"
    return truth, tuple(f"{text}: {value:.2f}" for text, value in values.items() if value < 1)


def iter_named(judge: Judge, accept: Sequence[str], agreed: Agreed) -> Iterator[dict[str, float]]:
    """The value of each predicate, under every naming of the objects that stand for each other."""
    ways = ([dict(zip(names, each, strict=True)) for each in permutations(names)] for names in agreed)
    for chosen in product(*ways):
        bodies = {name: body for way in chosen for name, body in way.items()}
        yield {text: judge.judge(_rename(text, bodies)) for text in accept}


def _rename(text: str, bodies: dict[str, str]) -> str:
    return re.sub(r"\w+", lambda word: bodies.get(word[0], word[0]), text)
