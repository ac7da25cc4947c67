"""How often an answer called each library of planning, counted where it is called."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from enum import StrEnum


class Solver(StrEnum):
    """A library, and what one call of it is."""

    MINK = "mink"  # a quadratic program of a posture
    OMPL = "ompl"  # a search for a path
    TOPPRA = "toppra"  # a timing of a path
    CASADI = "casadi"  # a shaped timing of a carry


_CALLS: ContextVar[Counter[Solver] | None] = ContextVar("calls", default=None)


@contextmanager
def counting_calls() -> Iterator[Counter[Solver]]:
    """The calls that are made inside, by library."""
    calls = Counter[Solver]()
    token = _CALLS.set(calls)
    try:
        yield calls
    finally:
        _CALLS.reset(token)


def count_call(solver: Solver) -> None:
    """Count one call."""
    if (calls := _CALLS.get()) is not None:
        calls[solver] += 1
