"""What a predicate is evaluated on."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from phyagentos.protocol.world.environment import Environment


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """What a predicate is evaluated on.

    Attributes:
        initial: The snapshot that changes are measured against, None when there is none.
        target: What the word `target` means, None when nothing.
        metrics: What was measured on the way, by name; units in the names.
        interchangeable: Groups of names that the goal lets stand for each other.
    """

    now: Environment
    initial: Environment | None = None
    target: str | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    interchangeable: tuple[tuple[str, ...], ...] = ()
