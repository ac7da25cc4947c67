"""The player's own knowledge and motions: what it sees and carries, routes that it follows, places that it searches.

A motion is a generator like a tool: it yields an action for each step, None to let time go by. What the game refuses
raises `ToolFailed`, after the player has looked again.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from target_server.tool_body import ToolFailed

from luanti_body.book import CRAFT_S, OF_PICK, PICKS, Book
from luanti_body.terrain import PUT_S, SIDES, WALK_S, Cell, Move, Terrain, read_kinds
from luanti_body.world import CallRefused, Link

Action = Mapping[str, Any] | None
"""A call of the mod by `name`, with its arguments."""
ADVANCE = 10  # nodes of one stretch of a search
UNDERGROUND = 14  # nodes below the start, where is searched for what is dug out of stone; later another floor down
FLOOR = 6
BUILDING = ("default:dirt", "default:cobble", "default:desert_cobble", "default:gravel", "default:sand")
SOFT = {"", "default:axe_wood", "default:shovel_wood"}  # what digs nodes that are found above ground
TRIES = 8  # routes in a row that may lead nowhere, or nodes that may fall down
STEP_S = 0.1


class Agent:
    """One player.

    Attributes:
        at: The cell of its feet.
        items: What it carries, by the game's names.
        health: Of 20; at zero it is dead.
        day: Part of the day since midnight, 0..1; `light` where it is, 0..1.
        creatures: Names and positions of those in view.
        refusal: Why the game did not do the last action; empty where it did. `answer` is what it answered.
        heading: Of its searches, an index of `SIDES`.
    """

    def __init__(self, link: Link, heading: int) -> None:
        self._link, self.heading, self._first_heading = link, heading, heading
        self.book = Book(**link.call("book"))
        self.terrain = Terrain(read_kinds(self.book.nodes))
        self.refusal, self.answer = "", dict[str, Any]()
        self._names: list[str] = []
        self._searched = set[Cell]()
        self._debt_s, self._had_pick = 0.0, False
        self.look()
        self._start = self.at

    def look(self) -> None:
        """See what is in view now, and what is carried."""
        seen = self._link.call("look")
        self.at = _read_cell(seen["at"])
        self._names += seen["names"] or ()
        self.terrain.note(self._names, seen["nodes"] or (), seen.get("times"))
        self.items: dict[str, int] = {name: int(n) for name, n in (seen["items"] or {}).items()}
        self._had_pick |= PICKS[1] in self.items
        self.terrain.blocks = sum(self.items.get(name, 0) for name in BUILDING)
        self.health, self.breath = float(seen["hp"]), float(seen["breath"])
        self.day, self.light = float(seen["day"]), float(seen["light"]) / 14.0
        self.creatures = [(str(name), _read_cell(at)) for name, at in seen["creatures"] or ()]

    def act(self, action: Action, clock_s: float) -> None:
        """Let so much time pass on the clock of the day, do an action, and look."""
        self._link.call("pass", seconds=clock_s)
        self.refusal = ""
        if action is not None and self.health > 0:
            try:
                self.answer = self._link.call(**action)
            except CallRefused as refusal:
                self.refusal = str(refusal)
        self.look()

    def list_items(self, kind: str) -> Sequence[str]:
        """The game's names of a kind of item; raises `ToolFailed` where it has none."""
        if kind not in self.book.kinds:
            raise ToolFailed(f"the game has no {kind}")
        return self.book.kinds[kind]

    def count(self, kind: str) -> int:
        """How many of a kind are carried."""
        return sum(self.items.get(item, 0) for item in self.list_items(kind))

    def can_dig(self, node: str) -> bool:
        """Whether it carries a tool for a kind of node, or needs none."""
        tools = self.book.nodes[node]["tools"] or ()
        return "" in tools or any(tool in self.items for tool in tools)

    def list_seen(self, kind: str) -> set[Cell]:
        """Where nodes of a kind were seen; raises `ToolFailed` where none was."""
        names = self.list_items(kind)
        if not (found := {cell for name in names for cell in self.terrain.places.get(name, ())}):
            raise ToolFailed(f"no {kind} was seen")
        return found

    def spend(self, seconds: float) -> Iterator[Action]:
        """Let time go by; what is less than a step is kept for the next time."""
        self._debt_s += seconds
        while self._debt_s >= STEP_S:
            self._debt_s -= STEP_S
            yield None

    def do(self, seconds: float, /, **action: Any) -> Iterator[Action]:
        """Act after so much time; raises `ToolFailed` where the game refuses."""
        if self.health <= 0:
            raise ToolFailed("the player is dead")
        yield from self.spend(seconds)
        yield action
        if self.refusal:
            raise ToolFailed(self.refusal)

    def dig(self, cell: Cell) -> Iterator[Action]:
        """Dig a node in reach; what falls down into its place is dug, too, and before it what fell onto the player.

        A pick of stone that is worn out is made anew of what is carried, so that no better tool is spent on stone.
        """
        wanted = cell
        for _ in range(TRIES):
            is_worn = self._had_pick and PICKS[1] not in self.items
            if is_worn and all(self.items.get(item, 0) >= count for item, count in OF_PICK.items()):
                yield from self.do(CRAFT_S, name="craft", item=PICKS[1])
            x, y, z = self.at
            cell = next((each for each in ((x, y + 1, z), self.at) if self.terrain.is_solid(each)), wanted)
            if self.terrain.is_open(cell):
                return
            name = self.terrain.cells.get(cell, "")
            if name not in self.terrain.times:
                raise ToolFailed(f"{name or 'what is there'} needs another tool")
            yield from self.do(self.terrain.times[name], name="dig", at=cell)

    def put(self, cell: Cell, item: str) -> Iterator[Action]:
        """Place a node there; where it stands itself it stands on it then."""
        yield from self.do(PUT_S, name="put", at=cell, item=item)

    def set_up(self, item: str) -> Iterator[Action]:
        """Place a node beside it, where there is or can be dug room; the cell is `spot`."""
        x, y, z = self.at
        sides = [(x + u, y, z + w) for u, w in SIDES]
        known = [cell for cell in sides if self.terrain.is_solid((cell[0], y - 1, cell[2]))] or sides
        open_ones = [cell for cell in known if self.terrain.is_open(cell)]
        self.spot = (open_ones or known)[0]
        yield from self.dig(self.spot)
        yield from self.put(self.spot, item)

    def dig_nearest(self, cells: Collection[Cell]) -> Iterator[Action]:
        """Go to where one of these cells can be reached, and dig it."""
        yield from self.travel(cells, to_reach=True)
        yield from self.dig(next(cell for cell in self.list_nearest(cells) if self.terrain.can_reach(self.at, cell)))

    def list_nearest(self, cells: Collection[Cell], most: int = 8) -> list[Cell]:
        """The nearest of these cells."""
        return sorted(cells, key=lambda cell: (math.dist(cell, self.at), cell))[:most]

    def travel(self, cells: Collection[Cell], *, to_reach: bool = False) -> Iterator[Action]:
        """Go to one of these cells, or to where one can be reached; the route is made anew when more is seen."""
        vain = 0
        while True:
            goals = self.list_nearest(cells)
            route = self.terrain.find_route(self.at, goals, to_reach=to_reach)
            if route is None:
                raise ToolFailed("no route was found")
            if not route:
                return
            at, known, reason = self.at, len(self.terrain.cells), ""
            try:
                yield from self._follow(route)
            except ToolFailed as failure:
                reason = str(failure)
            vain = vain + 1 if (at, known) == (self.at, len(self.terrain.cells)) else 0
            if vain > TRIES or self.health <= 0:
                raise ToolFailed(f"it makes no progress: {reason or 'the ground is not as it was'}")

    def _follow(self, route: Sequence[Move]) -> Iterator[Action]:
        """Make moves until one is not as it was thought to be."""
        for move in route:
            moves = [each for each in self.terrain.iter_moves(self.at) if each.to == move.to]
            now = min(moves, key=lambda each: each.seconds, default=None)
            if now is None or now.seconds > move.seconds + 1e-6:
                return
            at = self.at
            for cell in now.digs:
                yield from self.dig(cell)
            if self.at == at and now.put is not None:
                item = next(each for each in BUILDING if self.items.get(each))
                yield from self.put(now.put, item)
            if self.at == at:
                yield from self.do(WALK_S, name="go", to=move.to)
            if self.at != move.to:
                return

    def search(self, sources: Sequence[str]) -> Iterator[Action]:
        """Go a stretch on to where nodes of these kinds may be: on the surface, into caves, or through stone."""
        (u, w), (x, y, z) = SIDES[self.heading % len(SIDES)], self.at
        if all(SOFT.isdisjoint(self.book.nodes[name]["tools"] or ()) for name in sources):
            level = self._start[1] - UNDERGROUND - FLOOR * ((self.heading - self._first_heading) // len(SIDES))
            if y <= level + FLOOR and (caves := self._list_caves(level)):
                self._searched.add(caves[0])
                yield from self.travel({caves[0]})
                return
            ahead = (x + u * ADVANCE, level, z + w * ADVANCE) if y <= level else (x, max(level, y - ADVANCE), z)
            if ahead in self.terrain.cells and y <= level:
                raise ToolFailed("it was there before")
            yield from self.travel({ahead})
            return
        edges = self.terrain.list_edges(self.at, 2 * ADVANCE)
        best = max(((u * (cell[0] - x) + w * (cell[2] - z), cell) for cell in edges), default=(0, self.at))
        if best[0] < 2:
            raise ToolFailed("there is no ground ahead")
        yield from self.travel({best[1]})

    def _list_caves(self, level: int) -> list[Cell]:
        """Ground at the edge of what was seen of caves near, not searched yet; the nearest first."""
        edges = self.terrain.list_edges(self.at, ADVANCE)
        open_ones = {
            cell
            for cell in edges
            if cell[1] <= level + FLOOR and self.terrain.has_unseen(cell) and cell not in self._searched
        }
        return self.list_nearest(open_ones)


def _read_cell(numbers: Sequence[float]) -> Cell:
    x, y, z = map(int, numbers)
    return x, y, z
