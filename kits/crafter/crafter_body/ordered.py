"""Crafter with an order: the same seed and actions give the same life.

Its chunks keep their objects in sets, which are ordered by addresses of memory; here they are kept in order of arrival.
Its picture is not drawn, which no one looks at here: at night its noise would draw numbers, so that lives differ from
those of the same seed with pictures, by chance and by nothing else.
"""

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import crafter


class OrderedSet:
    """The part of a set that Crafter's chunks use."""

    def __init__(self) -> None:
        self._items: dict[Any, None] = {}

    def add(self, item: Any) -> None:
        """Last, where it is new."""
        self._items[item] = None

    def remove(self, item: Any) -> None:
        """Raises KeyError where it is not."""
        del self._items[item]

    def __iter__(self) -> Iterator[Any]:
        return iter([*self._items])


def make_env(seed: int) -> Any:
    """One life, begun, of the benchmark's own length (10 000 steps)."""
    env = crafter.Env(seed=seed)
    reset = env._world.reset

    def reset_in_order(seed: int | None = None) -> None:
        reset(seed)
        env._world._chunks = defaultdict(OrderedSet)

    env._world.reset = reset_in_order
    env._obs = env._sem_view = lambda: None
    env.reset()
    return env
