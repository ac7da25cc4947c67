"""What is asked in one room: nodes, goals, and what is made ready while they are drawn."""

from collections.abc import Callable
from dataclasses import dataclass, field

from benchmarks.worlds.forms import Rng
from benchmarks.worlds.rooms import Floor, Room, SceneObject


@dataclass(frozen=True, slots=True)
class Node:
    """One session as it is asked for.

    Attributes:
        arguments: Of the skill.
        accept: Predicates, in the language of goal graphs.
        is_claim: Whether it only looks.
        after: Names of nodes before it.
    """

    name: str
    skill: str
    arguments: dict[str, object]
    accept: tuple[str, ...]
    is_claim: bool = False
    after: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Case:
    """One goal in one room.

    Attributes:
        detail: Name of the impossible detail; empty where there is none.
        faults: As in a fault file, without the pattern of the session.
        constraints: Sampled all through.
        accept: The goal's own acceptance.
        interchangeable: Groups of equal objects that may stand for each other.
    """

    seed: int
    room: Room
    nodes: tuple[Node, ...]
    detail: str = ""
    faults: tuple[dict[str, object], ...] = ()
    constraints: tuple[str, ...] = ()
    accept: tuple[str, ...] = ()
    interchangeable: tuple[tuple[str, ...], ...] = ()

    @property
    def name(self) -> str:
        """Of the goal."""
        return f"unseen_{self.seed}"


@dataclass(slots=True)
class Draft:
    """A goal that is being drawn: its room, the places that are taken, and the names that nodes take up."""

    room: Room
    floor: Floor
    rng: Rng
    nodes: list[Node] = field(default_factory=list)
    used: set[str] = field(default_factory=set)

    def choose(self, fits: Callable[[SceneObject], bool] = lambda _: True) -> SceneObject | None:
        """A movable object that no node takes up yet, and on which nothing stands."""
        under = {item.on for item in self.room.movable}
        free = [t for t in self.room.movable if t.name not in self.used | under and fits(t)]
        if not free:
            return None
        found = free[int(self.rng.integers(len(free)))]
        self.used.add(found.name)
        return found

    def pick(self, names: list[str]) -> str:
        """One of these names."""
        return names[int(self.rng.integers(len(names)))]

    def add(self, skill: str, arguments: dict[str, object], *accept: str, is_claim: bool = False) -> None:
        """One more node."""
        after = (self.nodes[-1].name,) if self.nodes and self.rng.random() < 0.3 else ()
        self.nodes.append(Node(f"n{len(self.nodes) + 1}", skill, arguments, accept, is_claim, after))
