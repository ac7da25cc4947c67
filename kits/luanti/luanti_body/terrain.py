"""What was seen of a world of nodes, and routes through it by walking, digging, bridging and building up.

A cell is a node by its integers x, y (up) and z. The player stands in the cell of its feet and fills the one above.
What was never seen counts as ground that can be dug; it is looked at before the next step, and the route made anew.
"""

import heapq
import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Cell = tuple[int, int, int]
SIDES = ((1, 0), (0, 1), (-1, 0), (0, -1))
FACES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
WALK_S, SWIM_S, PUT_S = 0.25, 0.5, 0.25  # walking and swimming a node; the game's speed is 4 nodes/s
UNSEEN_S = 1.5  # what an unseen cell is thought to take
REACH, EYE = 4.4, 1.12  # nodes; the mod's own reach is a tenth longer
DROP = 3  # nodes that it steps down at most
EAGER = ((1.0, 400), (4.0, 1200))  # seconds that a node is thought to take, and cells that are looked at
NEVER = math.inf


@dataclass(frozen=True)
class Kind:
    """What the game's book says of a kind of node."""

    is_solid: bool
    is_liquid: bool
    hurts: bool
    falls: bool


@dataclass(frozen=True)
class Move:
    """One step: cells that are dug first, one that is filled first, and where it stands then."""

    to: Cell
    seconds: float
    digs: tuple[Cell, ...] = ()
    put: Cell | None = None


@dataclass
class Terrain:
    """Memory of what was seen.

    Attributes:
        kinds: By name of node.
        cells: What was seen last at each cell.
        places: Cells by name of node, without air.
        times: To dig each kind of node, by what is carried now [s]; those that cannot be dug are left out.
        blocks: How many nodes are carried to build with.
    """

    kinds: Mapping[str, Kind]
    cells: dict[Cell, str] = field(default_factory=dict)
    places: dict[str, set[Cell]] = field(default_factory=lambda: defaultdict(set))
    times: Mapping[str, float] = field(default_factory=dict)
    blocks: int = 0
    _clearing: dict[Cell, float] = field(default_factory=dict)

    def note(self, names: Sequence[str], nodes: Sequence[float], times: Mapping[str, float] | None) -> None:
        """Take what was seen: x, y, z and the index of a name, node after node; and new times of digging."""
        self.times = times if times is not None else self.times
        numbers = iter(map(int, nodes))
        for x, y, z, index in zip(numbers, numbers, numbers, numbers, strict=True):
            cell, name = (x, y, z), names[index]
            if (known := self.cells.get(cell)) is not None:
                self.places[known].discard(cell)
            self.cells[cell] = name
            if name != "air":
                self.places[name].add(cell)
        self._clearing.clear()

    def is_open(self, cell: Cell) -> bool:
        """Whether it was seen to be open."""
        kind = self._find(cell)
        return kind is not None and not kind.is_solid

    def is_solid(self, cell: Cell) -> bool:
        """Whether it was seen to be solid."""
        kind = self._find(cell)
        return kind is not None and kind.is_solid

    def is_liquid(self, cell: Cell) -> bool:
        """Whether it was seen to be liquid."""
        kind = self._find(cell)
        return kind is not None and kind.is_liquid

    def _find(self, cell: Cell) -> Kind | None:
        name = self.cells.get(cell)
        return self.kinds[name] if name is not None else None

    def _is_near(self, cell: Cell, trait: str) -> bool:
        x, y, z = cell
        return any(
            (kind := self._find((x + u, y + v, z + w))) is not None and getattr(kind, trait) for u, v, w in FACES
        )

    def measure_clearing(self, cell: Cell) -> float:
        """How long it takes until one can be in a cell [s]; NEVER where that is dangerous or needs another tool."""
        if cell not in self._clearing:
            self._clearing[cell] = self._measure_clearing(cell)
        return self._clearing[cell]

    def _measure_clearing(self, cell: Cell) -> float:
        kind = self._find(cell)
        if kind is None:
            return UNSEEN_S
        if kind.hurts or self._is_near(cell, "hurts"):
            return NEVER
        if not kind.is_solid:
            return 0.0
        if self._is_near(cell, "is_liquid"):
            return NEVER
        above = self._find((cell[0], cell[1] + 1, cell[2]))
        return self.times.get(self.cells[cell], NEVER) + (1.0 if above is not None and above.falls else 0.0)

    def iter_moves(self, at: Cell) -> Iterator[Move]:
        """Steps from a cell, with what has to be dug or filled for each."""
        x, y, z = at
        if self._is_ground((x, y - 2, z)):
            yield from self._make_move((x, y - 1, z), ((x, y - 1, z),))
        if self.blocks:
            yield from self._make_move((x, y + 1, z), ((x, y + 2, z),), put=at)
        for u, w in SIDES:
            cell = (x + u, y, z + w)
            up, down = (cell[0], y + 1, cell[2]), (cell[0], y - 1, cell[2])
            if self._is_ground(down):
                yield from self._make_move(cell, (up, cell))
            elif self.blocks and not self.is_liquid(down):
                yield from self._make_move(cell, (up, cell), put=down)
            if self._is_ground(cell) and not self.is_liquid(cell):
                yield from self._make_move(up, ((x, y + 2, z), (cell[0], y + 2, cell[2]), up))
            if self._is_ground((cell[0], y - 2, cell[2])):
                yield from self._make_move(down, (up, cell, down))
            elif self.is_open(up) and self.is_open(cell) and self.is_open(down):
                yield from self._drop(cell, y - 2)

    def _drop(self, over: Cell, y: int) -> Iterator[Move]:
        x, _, z = over
        for lower in range(y, y - DROP + 1, -1):
            if not self.is_open((x, lower, z)):
                return
            if self._is_ground((x, lower - 1, z)):
                yield from self._make_move((x, lower, z), ())
                return

    def _is_ground(self, cell: Cell) -> bool:
        kind = self._find(cell)
        return kind is None or kind.is_solid or (kind.is_liquid and not kind.hurts)

    def _make_move(self, to: Cell, clears: tuple[Cell, ...], put: Cell | None = None) -> Iterator[Move]:
        seconds = SWIM_S if self.is_liquid(to) else WALK_S
        if self.is_liquid((to[0], to[1] + 1, to[2])):
            return  # its head stays above
        seconds += sum(map(self.measure_clearing, clears)) + (PUT_S if put is not None else 0.0)
        if seconds < NEVER:
            yield Move(to, seconds, tuple(cell for cell in clears if not self.is_open(cell)), put)

    def find_route(self, at: Cell, goals: Collection[Cell], *, to_reach: bool) -> list[Move] | None:
        """Quick moves to one of the cells, or to where one of them can be reached; None where none was found.

        Weighted A* (Pohl 1970), at first with what walking and digging in turn take, then with what digging takes.
        """
        for eager_s, expansions in EAGER:
            route = self._find_route(at, [*goals], REACH + EYE if to_reach else 0.0, eager_s, expansions)
            if route is not None:
                return route
        return None

    def _find_route(
        self, at: Cell, goals: Sequence[Cell], reach: float, eager_s: float, expansions: int
    ) -> list[Move] | None:
        def estimate(cell: Cell) -> float:
            return eager_s * max(0.0, min(math.dist(cell, goal) for goal in goals) - reach)

        costs, before = {at: 0.0}, dict[Cell, tuple[Cell, Move]]()
        queue, closed = [(estimate(at), at)] if goals else [], set[Cell]()
        while queue and len(closed) < expansions:
            _, cell = heapq.heappop(queue)
            if cell in closed:
                continue
            closed.add(cell)
            if cell in goals or (reach and any(self.can_reach(cell, goal) for goal in goals)):
                return _trace(before, cell)
            for move in self.iter_moves(cell):
                cost = costs[cell] + move.seconds
                if move.to not in closed and cost < costs.get(move.to, NEVER):
                    costs[move.to], before[move.to] = cost, (cell, move)
                    heapq.heappush(queue, (cost + estimate(move.to), move.to))
        return None

    def can_reach(self, at: Cell, goal: Cell) -> bool:
        """Whether a node is in reach, and its centre or a face in view, of who stands there."""
        eye = (at[0], at[1] + EYE, at[2])
        if math.dist(eye, goal) > REACH:
            return False
        points = [goal, *([g + 0.49 * d for g, d in zip(goal, face, strict=True)] for face in FACES)]
        own = {at, (at[0], at[1] + 1, at[2]), goal}
        return any(all(cell in own or self.is_open(cell) for cell in _list_between(eye, each, goal)) for each in points)

    def has_unseen(self, cell: Cell) -> bool:
        """Whether a cell beside it, or above that, was never seen."""
        x, y, z = cell
        return any((x + u, y + v, z + w) not in self.cells for u, w in SIDES for v in (0, 1))

    def list_edges(self, at: Cell, radius: int) -> list[Cell]:
        """Cells on which one could stand, seen to be so, no farther than that in x and z."""
        x, y, z = at
        return [
            (u, v, w)
            for u in range(x - radius, x + radius + 1)
            for w in range(z - radius, z + radius + 1)
            for v in range(y + radius // 2, y - radius // 2, -1)
            if self.is_solid((u, v - 1, w)) and self.is_open((u, v, w)) and self.is_open((u, v + 1, w))
        ]


def _list_between(start: Sequence[float], end: Sequence[float], goal: Cell) -> list[Cell]:
    """Cells that a straight line passes, up to the goal."""
    passed: list[Cell] = []
    length = math.dist(start, end)
    for index in range(int(length / 0.1) + 1):
        part = index * 0.1 / max(length, 1e-9)
        x, y, z = (math.floor(a + (b - a) * part + 0.5) for a, b in zip(start, end, strict=True))
        if (x, y, z) == goal:
            break
        if not passed or passed[-1] != (x, y, z):
            passed.append((x, y, z))
    return passed


def _trace(before: Mapping[Cell, tuple[Cell, Move]], cell: Cell) -> list[Move]:
    moves: list[Move] = []
    while cell in before:
        cell, move = before[cell]
        moves.append(move)
    return moves[::-1]


def read_kinds(nodes: Mapping[str, Mapping[str, Any]]) -> dict[str, Kind]:
    """Of the game's book."""
    names = ("is_solid", "is_liquid", "hurts", "falls")
    return {name: Kind(**{each: bool(node[each]) for each in names}) for name, node in nodes.items()}
