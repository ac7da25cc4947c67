"""What the map of a level shows, and the routes over it. The game's own screen remembers what was seen.

Of `nle`'s numbers of glyphs only what a player sees is used: kinds of monsters, terrain, and which objects are tools
for digging or bar a step. Unidentified objects keep their secret.
"""

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

import numpy as np
from nle import nethack
from numpy.typing import NDArray

Cell = tuple[int, int]
Costs = dict[Cell, float]
WIDTH, HEIGHT = 79, 21
DIRECTIONS: dict[Cell, str] = {
    (-1, 0): "h", (0, 1): "j", (0, -1): "k", (1, 0): "l", (-1, -1): "y", (1, -1): "u", (-1, 1): "b", (1, 1): "n",
}  # fmt: skip
BLANK = nethack.GLYPH_CMAP_OFF
DOORS = range(BLANK + 13, BLANK + 17)
WAYS_UP, WAYS_DOWN = (BLANK + 23, BLANK + 25), (BLANK + 24, BLANK + 26, BLANK + 54, BLANK + 55)  # a hole, a trap door
FREE, TRAPS = {12, *range(19, 32), 33, 35, 36, 54, 55}, range(42, 65)  # signs of the terrain
PASSIVE = {
    "floating eye", "blue jelly", "spotted jelly", "ochre jelly", "gelatinous cube", "acid blob",
    "gas spore", "brown mold", "yellow mold", "green mold", "red mold", "shrieker",
}  # fmt: skip
"""These harm only what strikes them."""
UNSEEN = ENGULFER, UNKNOWN = "engulfer", "unseen"
WHOLESOME = {
    "newt", "jackal", "fox", "coyote", "sewer rat", "giant rat", "gecko", "goblin", "hill orc", "Mordor orc",
    "Uruk-hai", "hobbit", "gnome", "gnome lord", "dwarf", "dwarf lord", "iguana", "rothe", "pony", "horse", "lichen",
    "giant ant", "fire ant", "wolf", "cave spider", "baby crocodile", "rock piercer",
}  # fmt: skip
"""Fresh corpses that can be eaten without harm."""
FRESH, SMELL = 25, 6  # turns since it was killed; cells within which it is fetched
FIGHT_COST, BOULDER_COST, TRAP_COST, DOOR_COST, FAR = 4.0, 6.0, 25.0, 2.0, 1e9
TRIES, AROUND = 2, 5  # of a step that does not succeed; cells about a place that may hide what was not seen
GAIN, ROCK, END, MISSED = 25.0, 0.1, 0.6, 0.3  # of a search: steps, rock beside a passage, or at its end; left after it


def _read_cost(glyph: int) -> float:
    """Of a step onto what it shows; 0 where none is possible."""
    if nethack.glyph_is_cmap(glyph):
        sign = nethack.glyph_to_cmap(glyph)
        return DOOR_COST if glyph in DOORS else float(sign in FREE) or TRAP_COST * (sign in TRAPS)
    if nethack.glyph_is_statue(glyph) or _name_object(glyph) == "boulder":
        return BOULDER_COST
    if name := name_monster(glyph):
        return 0.0 if name in PASSIVE else FIGHT_COST
    return 1.0


def _name_object(glyph: int) -> str:
    if not nethack.glyph_is_normal_object(glyph):
        return ""
    return str(nethack.OBJ_NAME(nethack.objclass(nethack.glyph_to_obj(glyph))))


def name_monster(glyph: int) -> str:
    """Its kind; empty where the glyph shows none that is hostile or may be."""
    if nethack.glyph_is_swallow(glyph):
        return ENGULFER
    if nethack.glyph_is_invisible(glyph) or nethack.glyph_is_warning(glyph):
        return UNKNOWN
    is_one = nethack.glyph_is_normal_monster(glyph) or nethack.glyph_is_detected_monster(glyph)
    return str(nethack.permonst(nethack.glyph_to_mon(glyph)).mname) if is_one else ""


def _list_cells(mask: NDArray[np.bool_]) -> set[Cell]:
    return {(int(x), int(y)) for y, x in zip(*np.nonzero(mask), strict=True)}


ALL = range(nethack.MAX_GLYPH)
DIGGERS = [each for each in ALL if _name_object(each) in ("pick-axe", "dwarvish mattock")]
FOOD = {
    each
    for each in ALL
    if nethack.glyph_is_body(each) and nethack.permonst(each - nethack.GLYPH_BODY_OFF).mname in WHOLESOME
}
COSTS = [_read_cost(each) for each in ALL]
IS_FOE = [name_monster(each) not in {"", *PASSIVE} for each in ALL]


@dataclass
class Level:
    """The memory of one level.

    Attributes:
        glyphs: (21, 79) as last seen.
        at: Where the agent stands.
        visited: Where it has stood.
        searched: How often it searched, by the cell.
        failed: Steps that did not succeed, from where to where.
        down: Where it goes down.
        up: Where it goes up.
        killed: When something was killed, by the cell [turns of the game].
        shunned: Stairs down that lead astray.
        peaceful: Glyphs of monsters that turned out to be at peace.
    """

    glyphs: NDArray[np.int16] = field(default_factory=lambda: np.zeros((HEIGHT, WIDTH), np.int16))
    at: Cell = (0, 0)
    visited: set[Cell] = field(default_factory=set)
    searched: Counter[Cell] = field(default_factory=Counter)
    failed: Counter[tuple[Cell, Cell]] = field(default_factory=Counter)
    down: set[Cell] = field(default_factory=set)
    up: set[Cell] = field(default_factory=set)
    killed: dict[Cell, int] = field(default_factory=dict)
    shunned: set[Cell] = field(default_factory=set)
    peaceful: set[int] = field(default_factory=set)

    def look(self, glyphs: NDArray[np.int16], at: Cell) -> None:
        """See it anew."""
        self.glyphs, self.at = glyphs, at
        self.visited.add(at)
        self.down |= _list_cells(np.isin(glyphs, WAYS_DOWN))
        self.down -= self.shunned
        self.up |= _list_cells(np.isin(glyphs, WAYS_UP))

    def show(self, cell: Cell) -> int:
        """Its glyph."""
        return int(self.glyphs[cell[1], cell[0]])

    def list_foes(self, reach: int) -> list[Cell]:
        """Monsters within so many steps that may be hostile, the nearest first; none that harm only who strikes."""
        x, y = self.at
        left, top = max(0, x - reach), max(0, y - reach)
        block = np.array(IS_FOE)[self.glyphs[top : y + reach + 1, left : x + reach + 1]]
        found = {(left + u, top + v) for u, v in _list_cells(block)} - {self.at}
        known = [cell for cell in found if self.show(cell) not in self.peaceful]
        return sorted(known, key=lambda cell: (measure(cell, self.at), cell))

    def iter_near(self, cell: Cell) -> Iterator[Cell]:
        """The cells beside one, in a fixed order."""
        for u, v in DIRECTIONS:
            if 0 < cell[0] + u < WIDTH and 0 <= cell[1] + v < HEIGHT:
                yield (cell[0] + u, cell[1] + v)

    def measure_routes(self, goals: Collection[Cell] = ()) -> tuple[Costs, dict[Cell, Cell]]:
        """Cost of each cell in reach, up to the first of `goals`, and the cell before it."""
        costs: Costs = {self.at: 0.0}
        before, queue, glyphs = dict[Cell, Cell](), [(0.0, self.at)], self.glyphs.tolist()
        while queue:
            cost, cell = heapq.heappop(queue)
            if cost > costs[cell]:
                continue
            if cell in goals:
                break
            glyph = glyphs[cell[1]][cell[0]]
            for near in self.iter_near(cell):
                shown = glyphs[near[1]][near[0]]
                step, total = COSTS[shown], cost + COSTS[shown]
                if not step or total >= costs.get(near, FAR) or shown in self.peaceful:
                    continue
                is_slanted = cell[0] != near[0] and cell[1] != near[1]
                if is_slanted and (step == BOULDER_COST or shown in DOORS or glyph in DOORS):
                    continue
                if self.failed[cell, near] < TRIES:
                    costs[near], before[near] = total, cell
                    heapq.heappush(queue, (total, near))
        return costs, before

    def find_route(self, goals: Collection[Cell]) -> list[Cell]:
        """The cells to the nearest of these, from the next step on; empty where none is in reach."""
        costs, before = self.measure_routes(goals)
        reached = [cell for cell in goals if cell in costs]
        if not reached:
            return []
        route = [min(reached, key=lambda cell: (costs[cell], cell))]
        while route[-1] in before:
            route.append(before[route[-1]])
        return route[-2::-1]

    def list_edges(self) -> set[Cell]:
        """Cells where it has not stood, beside what was not seen."""
        blank = np.pad(self.glyphs == BLANK, 1)
        beside = sum(blank[1 + v : 1 + v + HEIGHT, 1 + u : 1 + u + WIDTH].astype(int) for u, v in DIRECTIONS)
        return _list_cells((beside > 0) & (np.array(COSTS)[self.glyphs] > 0)) - self.visited

    def list_food(self, turn: int) -> set[Cell]:
        """Where a fresh corpse is near that can be eaten."""
        return {
            cell
            for cell, when in self.killed.items()
            if turn - when <= FRESH
            and (cell == self.at or (measure(cell, self.at) <= SMELL and self.show(cell) in FOOD))
        }

    def list_diggers(self) -> set[Cell]:
        """Where a tool for digging is in view."""
        return _list_cells(np.isin(self.glyphs, DIGGERS))

    def choose_search(self, costs: Costs) -> Cell:
        """Where a hidden door or passage is likeliest, for the cost: beside walls with much unseen behind."""
        blank = self.glyphs == BLANK

        def value(cell: Cell) -> tuple[float, Cell]:
            x, y = cell
            hidden = float(blank[max(0, y - AROUND) : y + AROUND + 1, max(0, x - AROUND) : x + AROUND + 1].mean())
            closed = [near for near in self.iter_near(cell) if not COSTS[self.show(near)]]
            rock = END if sum(near in costs for near in self.iter_near(cell)) <= 1 else ROCK
            gain = sum((rock if self.show(near) == BLANK else 1.0) * MISSED ** self.searched[near] for near in closed)
            return costs[cell] - GAIN * gain * hidden, cell

        return min(costs, key=value)


def measure(a: Cell, b: Cell) -> int:
    """Steps between two cells without walls."""
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]))
