"""What an agent in Crafter has seen: the cells of its local view, remembered, and the routes over them.

The view is the benchmark's own, nine cells wide and seven high. Nothing else of the map is ever read. At night the
benchmark's picture is noisy; this view is not.
"""

import heapq
from collections.abc import Collection, Mapping
from typing import Any

Cell = tuple[int, int]
VIEW = (9, 7)
DIRECTIONS: Mapping[Cell, str] = {(-1, 0): "left", (1, 0): "right", (0, -1): "up", (0, 1): "down"}
WALKABLE = {"grass", "sand", "path"}
OPEN = {*WALKABLE, "water", "lava"}  # to arrows, and a place for a stone
DIGGABLE = {"stone": "wood_pickaxe", "coal": "wood_pickaxe", "iron": "stone_pickaxe", "diamond": "iron_pickaxe"}
DIG_COST = 2.5  # steps: turn, dig, walk
EDGE = "edge"  # beyond it there is no world
BRIDGE_COST = 4.0  # and before that: put a stone into the water
FEAR_COST = 4.0
FOES, RANGE = {"zombie", "skeleton"}, 4
KEPT = 20  # looks for which a foe that went out of view is thought to be there
PLANT, RIPE = "plant", "ripe plant"


class LocalMap:
    """The memory of one life; cells are counted from where it began.

    Attributes:
        cells: Material of each cell as last seen.
        creatures: Kind by cell, of those in view.
        last_seen: Kind by cell, and how many looks ago, of those in view and of others where they were seen last.
    """

    def __init__(self, env: Any) -> None:
        self._env, self._player = env, env._player
        self._origin = tuple(int(each) for each in env._player.pos)
        self.cells: dict[Cell, str] = {}
        self.creatures: dict[Cell, str] = {}
        self.last_seen: dict[Cell, tuple[str, int]] = {}
        self.look()

    @property
    def at(self) -> Cell:
        """Where the agent stands."""
        return self._place(self._player.pos)

    @property
    def facing(self) -> Cell:
        """The cell before it."""
        (x, y), (u, v) = self.at, self._player.facing
        return (x + int(u), y + int(v))

    def look(self) -> None:
        """See the local view."""
        (x, y), (width, height) = self._player.pos, VIEW
        self.creatures, self._headings = {}, dict[Cell, Cell]()
        kept = ((cell, kind, ago) for cell, (kind, ago) in self.last_seen.items() if ago < KEPT or kind not in FOES)
        self.last_seen = {cell: (kind, ago + 1) for cell, kind, ago in kept}
        for u in range(int(x) - width // 2, int(x) + width // 2 + 1):
            for v in range(int(y) - height // 2, int(y) + height // 2 + 1):
                material, found = self._env._world[(u, v)]
                self.cells[self._place((u, v))] = material or EDGE
                self.last_seen.pop(self._place((u, v)), None)
                if found is not None and found is not self._player:
                    self._note(found)

    def _note(self, found: Any) -> None:
        kind = type(found).__name__.lower()
        cell = self._place(found.pos)
        if kind == PLANT:
            self.cells[cell] = RIPE if found.ripe else PLANT
        else:
            self.creatures[cell] = kind
            if kind == "arrow":
                self._headings[cell] = (int(found.facing[0]), int(found.facing[1]))
            else:
                self.last_seen[cell] = (kind, 0)

    def _place(self, pos: Any) -> Cell:
        return (int(pos[0]) - self._origin[0], int(pos[1]) - self._origin[1])

    def find(self, kinds: Collection[str]) -> set[Cell]:
        """Cells of these materials, and of creatures in view."""
        places = {cell for cell, material in self.cells.items() if material in kinds}
        return places | {cell for cell, kind in self.creatures.items() if kind in kinds}

    def is_free(self, cell: Cell) -> bool:
        """Whether it can be walked on now."""
        return self.cells.get(cell) in WALKABLE and cell not in self.creatures

    def list_dangers(self, at: Cell) -> list[Cell]:
        """Foes beside a place, zombies that can step beside it, and arrows that fly towards it without a wall."""
        beside = [cell for cell in list_neighbours(at) if self.is_free(cell)]
        return [
            cell
            for cell, kind in self.creatures.items()
            if (kind in FOES and measure(cell, at) == 1)
            or (kind == "zombie" and any(measure(cell, each) == 1 for each in beside))
            or (kind == "arrow" and measure(cell, at) <= RANGE and self._is_shot_at(cell, at))
        ]

    def _is_shot_at(self, cell: Cell, at: Cell) -> bool:
        u, v = self._headings[cell]
        steps = measure(cell, at)
        flight = [(cell[0] + n * u, cell[1] + n * v) for n in range(1, steps + 1)]
        return flight[-1] == at and all(self.cells.get(each) in OPEN for each in flight)

    def list_steps(self) -> dict[str, Cell]:
        """The cells that it can step on now, by direction."""
        x, y = self.at
        beside = {name: (x + u, y + v) for (u, v), name in DIRECTIONS.items()}
        return {name: cell for name, cell in beside.items() if self.is_free(cell)}

    def measure_routes(
        self, items: Collection[str], feared: Collection[str] = ()
    ) -> tuple[dict[Cell, float], dict[Cell, Cell]]:
        """Steps to each cell in reach by walking and, by these items, digging and bridging; the cell before each.

        Cells near creatures that are feared count for more.
        """
        foes = [cell for cell, (kind, _) in self.last_seen.items() if kind in feared]
        near_foes = {cell for foe in foes for cell in list_within(foe, RANGE)}
        costs, before, queue = {self.at: 0.0}, dict[Cell, Cell](), [(0.0, self.at)]
        while queue:
            cost, cell = heapq.heappop(queue)
            if cost > costs[cell]:
                continue
            for near in list_neighbours(cell):
                material = self.cells.get(near, "")
                if material in WALKABLE and near not in self.creatures:
                    step = 1.0
                elif DIGGABLE.get(material) in items:
                    step = DIG_COST
                elif material == "water" and {"stone", "wood_pickaxe"} <= {*items}:
                    step = BRIDGE_COST
                else:
                    continue
                step += FEAR_COST * (near in near_foes)
                if cost + step < costs.get(near, 1e9):
                    costs[near], before[near] = cost + step, cell
                    heapq.heappush(queue, (cost + step, near))
        return costs, before


def list_block(cell: Cell) -> list[Cell]:
    """A cell and the eight around it: where a station is in reach."""
    return [(cell[0] + u, cell[1] + v) for u in (-1, 0, 1) for v in (-1, 0, 1)]


def list_within(cell: Cell, steps: int) -> list[Cell]:
    """Cells that are no farther from one than so many steps."""
    x, y = cell
    return [(x + u, y + v) for u in range(-steps, steps + 1) for v in range(abs(u) - steps, steps - abs(u) + 1)]


def list_neighbours(cell: Cell) -> list[Cell]:
    """The four cells beside one, in a fixed order."""
    return [(cell[0] + u, cell[1] + v) for u, v in DIRECTIONS]


def measure(a: Cell, b: Cell) -> int:
    """Steps between two cells without walls."""
    return abs(a[0] - b[0]) + abs(a[1] - b[1])
