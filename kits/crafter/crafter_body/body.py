"""A life in Crafter as a body without joints: tools that walk, gather, make, fight and sleep by what was seen.

    python -m crafter_body < KEY

What it reports of itself is what the benchmark's picture shows: items, vitals, the local view, daylight. The
achievements are the benchmark's score: they stay in this process, and are an outcome when a session ends.
"""

import json
from collections.abc import Collection, Iterator, Mapping, Sequence

from crafter import constants
from target_server.body import Entity, State, append_outcome
from target_server.tool_body import Steps, Tool, ToolBody, ToolFailed
from target_server.wire import Refusal

from crafter_body.local_map import (
    DIRECTIONS,
    FOES,
    OPEN,
    PLANT,
    RIPE,
    WALKABLE,
    Cell,
    LocalMap,
    list_block,
    list_neighbours,
    measure,
)
from crafter_body.ordered import make_env

VITALS = ("health", "food", "drink", "energy")
SOURCES = {item: kind for kind, info in constants.collect.items() for item in info["receive"]}
GAME = {"zombie", "skeleton", "cow"}
GROUNDS = {"mountain": {"stone", "coal", "iron", "diamond", "skeleton"}, "grass": {"cow", "zombie"}}  # what is where
IN_THE_DARK = " in the dark"
NIGHT = 0.35  # daylight below which it is dark
DAY, WELL = 0.5, 6  # daylight, and health, at which a rest ends
AWAY = 12.0  # steps that another frontier may be farther if it is of the wanted ground
NEAR = 3  # cells from a plant that grows
WEARY = 1  # energy at which it sleeps anywhere
ROOM = 2  # cells of a shelter
LOSSES = {"zombie": "zombie", "skeleton": "arrow", "arrow": "arrow", "no food": "hunger", "no drink": "thirst"}
WAITS = {"food": 3.0, "drink": 3.0}  # it goes out by night, or hurt, only for so much less, once warned of foes
MARGINS = {
    "zombie": ("health", "light", *WAITS),
    "arrow": ("health", *WAITS),
    "hunger": ("food",),
    "thirst": ("drink",),
}
MARGIN = {"health": 2.0, "food": 2.0, "drink": 2.0, "light": 0.1}  # kept beside what is needed, once warned
HURT = 3  # health
STRIKE = 2  # cells from which a foe that was seen may have struck
TRIES = 400  # of collecting one found


class CrafterBody(ToolBody[str]):
    """One life; after its end nothing moves any more, and its tools say so."""

    target, driver, step_s, has_truth = "survivor", "crafter", 0.1, True

    def __init__(self) -> None:
        kind, amount = {"what": "string"}, {"what": "string", "amount": "integer"}
        items = {"what": tuple(SOURCES)}
        self.toolbox: Mapping[str, Tool[str]] = {
            "collect": Tool(self.collect, amount, items),
            "place": Tool(self.place, kind, {"what": tuple(constants.place)}),
            "make": Tool(self.make, kind, {"what": tuple(constants.make)}),
            "hunt": Tool(self.hunt, kind, {"what": tuple(sorted(GAME))}),
            "find": Tool(self.find, kind),
            "drink": Tool(self.drink),
            "eat": Tool(self.eat),
            "defend": Tool(self.defend),
            "sleep": Tool(self.sleep),
            "tend": Tool(self.tend),
            "wait": Tool(self.wait, {"steps": "integer"}),
            "beware": Tool(self.beware, {"of": "string"}),
        }
        self._seed, self._cause, self._history = 0, "", list[str]()
        self._begin(0)

    def _begin(self, seed: int) -> None:
        self._seed, self._cause, self._history = seed, "", []
        self._env = make_env(seed)
        self._map, self._is_over, self._feared = LocalMap(self._env), False, set[str]()
        self._ahead = dict[str, Cell]()
        self._steps = 0

    @property
    def time_s(self) -> float:
        return self._steps * self.step_s

    @property
    def _items(self) -> dict[str, int]:
        found: dict[str, int] = self._env._player.inventory
        return found

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        if not snapshot:
            self._begin(seed)
            return
        try:
            seed, actions = json.loads(snapshot)
            names = [str(each) for each in actions]
        except (ValueError, TypeError) as error:
            raise Refusal("MALFORMED", f"no life of Crafter: {error}") from error
        self._begin(int(seed))
        for name in names:
            self.act(name)

    def snapshot(self) -> tuple[str, bytes]:
        """The seed and every action since: a life is lived again from its beginning."""
        return "application/json", json.dumps((self._seed, self._history)).encode()

    def read(self) -> State:
        player, (x, y) = self._env._player, self._map.at
        near = {self._map.cells.get(cell) for cell in list_block((x, y))}
        light = float(self._env._world.daylight)
        vitals = {name: float(self._items[name]) for name in VITALS}
        vitals |= {"calm": float(not self._map.list_dangers((x, y))), "awake": float(not player.sleeping)}
        vitals |= {f"lost_to_{each}": float(each == self._loss) for each in MARGINS}
        vitals["light"] = light
        vitals |= {f"spare_{name}": vitals[name] - self._find_margin(name) for name in MARGIN}
        return State(
            base=(float(x), float(y), 0.0),
            inventory={name: n for name, n in self._items.items() if n and name not in VITALS},
            vitals=vitals,
            nearby=tuple(name for name in ("table", "furnace", "water") if name in near),
            daylight=light,
        )

    @property
    def _loss(self) -> str:
        """What this life ended by; empty while it goes on, and where that is not known."""
        return LOSSES.get(self._cause.removesuffix(IN_THE_DARK), "") if self._items["health"] <= 0 else ""

    def _find_margin(self, vital: str) -> float:
        if vital in WAITS and (self._env._world.daylight < DAY or self._items["health"] <= HURT):
            return -WAITS[vital] if {"zombie", "arrow"} & self._feared else 0.0
        return MARGIN[vital] if any(vital in MARGINS[each] for each in self._feared) else 0.0

    def list_entities(self) -> Sequence[Entity]:
        """Creatures in view, and the nearest of each kind of place that was seen."""
        x, y = self._map.at
        nearest: dict[str, Cell] = {}
        for cell, material in self._map.cells.items():
            known = nearest.get(material)
            if material not in WALKABLE and (known is None or measure(cell, (x, y)) < measure(known, (x, y))):
                nearest[material] = cell
        found = [(kind.replace(" ", "_"), kind, cell) for kind, cell in nearest.items()]
        found += [(f"{kind}_{number}", kind, cell) for number, (cell, kind) in enumerate(self._map.creatures.items())]
        return [Entity(name, kind, (float(u), float(v), 0.0), movable=False) for name, kind, (u, v) in found]

    def act(self, action: str | None) -> None:
        self._steps += 1
        self._history.append(action or "noop")
        if self._is_over:
            return
        before, creatures = self._items["health"], self._map.creatures
        _, _, self._is_over, _ = self._env.step(constants.actions.index(action or "noop"))
        self._map.look()
        if self._items["health"] < before:
            self._cause = self._find_cause({**creatures, **self._map.creatures})

    def note_end(self, session: str) -> None:
        """The benchmark's own count, for who measures."""
        is_dead = self._items["health"] <= 0
        append_outcome(
            session,
            seed=self._seed,
            steps=self._steps,
            completed=sorted(name for name, n in self._env._player.achievements.items() if n),
            is_dead=is_dead,
            cause=self._cause if is_dead else "",
            lost_to=self._loss,
            daylight=self._env._world.daylight,
        )

    def collect(self, what: str, amount: int) -> Steps[str]:
        """Tool: carry so many of an item, from where it was seen or is found."""
        for _ in range(TRIES):
            if self._items[what] >= amount:
                return f"carries {self._items[what]} {what}"
            tool = next(iter(constants.collect[SOURCES[what]]["require"]), "")
            if tool and not self._items[tool]:
                raise ToolFailed(f"{what} needs a {tool}")
            yield from self._face({SOURCES[what]})
            yield "do"
        raise ToolFailed(f"{amount} {what} were not found in {TRIES} tries")

    def place(self, what: str) -> Steps[str]:
        """Tool: put an item before it."""
        info = constants.place[what]
        if lacking := [f"{n} {item}" for item, n in info["uses"].items() if self._items[item] < n]:
            raise ToolFailed(f"a {what} takes {', '.join(lacking)}")
        stations = {"table"} if what == "furnace" and self._map.find({"table"}) else set[str]()
        yield from self._face_spot(self._map.find(set(info["where"]) & WALKABLE), stations)
        yield f"place_{what}"
        return f"placed a {what}"

    def make(self, what: str) -> Steps[str]:
        """Tool: make a tool where it is made."""
        info = constants.make[what]
        if lacking := [f"{n} {item}" for item, n in info["uses"].items() if self._items[item] < n]:
            raise ToolFailed(f"a {what} takes {', '.join(lacking)}")
        yield from self._stand_near(set(info["nearby"]), what)
        yield f"make_{what}"
        return f"made a {what}"

    def hunt(self, what: str) -> Steps[str]:
        """Tool: find a creature and strike it until it is gone."""
        for _ in range(TRIES):
            yield from self._face({what})
            cell = self._map.facing
            yield "do"
            if not any(measure(cell, other) <= 1 for other in self._map.find({what})):
                return f"no {what} is left here"
        raise ToolFailed(f"the {what} got away")

    def find(self, what: str) -> Steps[str]:
        """Tool: look about until such a place or creature is beside it."""
        yield from self._face({what})
        return f"stands before a {what}"

    def drink(self) -> Steps[str]:
        """Tool: drink until it is not thirsty."""
        while self._items["drink"] < constants.items["drink"]["max"]:
            yield from self._face({"water"})
            yield "do"
        return "is not thirsty"

    def eat(self) -> Steps[str]:
        """Tool: eat a ripe plant, or a cow."""
        before = self._items["food"]
        while self._items["food"] <= before:
            yield from self._face({RIPE, "cow"})
            yield "do"
        return "has eaten"

    def defend(self) -> Steps[str]:
        """Tool: strike what is beside it, close the line of an arrow with a stone or leave it, and await a zombie."""
        while dangers := self._map.list_dangers(self._map.at):
            self._check_alive()
            at, kinds = self._map.at, self._map.creatures
            beside = [cell for cell in dangers if measure(cell, at) == 1 and kinds[cell] in FOES]
            arrows = [cell for cell in dangers if kinds[cell] == "arrow"]
            safe = [name for name, cell in self._map.list_steps().items() if not self._map.list_dangers(cell)]
            if beside:
                yield "do" if self._map.facing in beside else self._turn(beside[0])
            elif self._items["stone"] and self._is_open(self._map.facing) and self._is_towards(dangers[0]):
                yield "place_stone"
            elif arrows and safe:
                yield f"move_{safe[0]}"
            else:
                yield "noop"
        return "nothing is near"

    def _is_open(self, cell: Cell) -> bool:
        return self._map.cells.get(cell) in OPEN and cell not in self._map.creatures

    def _is_towards(self, cell: Cell) -> bool:
        return measure(self._map.facing, cell) < measure(self._map.at, cell)

    def sleep(self) -> Steps[str]:
        """Tool: wall itself in where stone is, and sleep until it is day, and it is awake and well."""
        try:
            yield from self._wall_in()
        except ToolFailed:  # without stone it sleeps in the open, unless an earlier life was lost so
            if "zombie" in self._feared and self._items["energy"] > WEARY:
                raise
        yield "sleep"
        while self._env._player.sleeping or (self._needs_rest() and self._items["food"] and self._items["drink"]):
            yield "sleep"
        return "has slept"

    def _needs_rest(self) -> bool:
        is_day = self._env._world.daylight >= DAY + self._find_margin("light")
        return not is_day or self._items["health"] < WELL + self._find_margin("health")

    def tend(self) -> Steps[str]:
        """Tool: wall a plant in, stay near while it grows, and eat it when it is ripe."""
        if not self._map.find({PLANT, RIPE}):
            yield from self.place("plant")
        while not self._map.find({RIPE}):
            self._check_alive()
            plant = min(self._map.find({PLANT}), key=lambda cell: measure(cell, self._map.at), default=None)
            if plant is None:
                raise ToolFailed("the plant is gone")
            gaps = {cell for cell in list_neighbours(plant) if self._map.is_free(cell)} - {self._map.at}
            if gaps and self._items["stone"]:
                yield from self._face_spot(gaps)
                yield "place_stone"
            elif measure(plant, self._map.at) > NEAR:
                yield self._go_near(plant)
            else:
                yield "noop"
        before = self._items["food"]
        yield from self._face({RIPE}, explore=False)
        yield "do"
        return f"has eaten, food is {self._items['food']} after {before}"

    def beware(self, of: str) -> Steps[str]:
        """Tool: keep a margin to what earlier lives were lost to, by the conditions that were violated then."""
        self._feared = {each for each in MARGINS if f"lost_to_{each}" in of}
        yield from ()
        return f"is wary of {', '.join(sorted(self._feared)) or 'nothing'}"

    def wait(self, steps: int) -> Steps[str]:
        """Tool: do nothing."""
        for _ in range(steps):
            yield "noop"
        return f"waited {steps} steps"

    def _find_cause(self, creatures: Mapping[Cell, str]) -> str:
        """Why health was just lost, by what is felt, and was seen now and a step before."""
        near = {kind for cell, kind in creatures.items() if measure(cell, self._map.at) <= STRIKE}
        dark = IN_THE_DARK if self._env._world.daylight < NIGHT else ""
        if self._map.cells.get(self._map.at) == "lava":
            return "lava"
        if found := sorted(near & {"zombie", "arrow", "skeleton"}):
            return f"{found[-1]}{dark}"
        return next((f"no {name}" for name in ("food", "drink", "energy") if not self._items[name]), "unknown")

    def _face(self, kinds: Collection[str], *, explore: bool = True) -> Iterator[str]:
        """Walk and dig until such a cell or creature is before it; look for one where none was seen."""
        while True:
            self._check_alive()
            goals = self._map.find(kinds)
            if self._map.facing in goals:
                return
            costs, before = self._measure_routes()
            routes = {n: costs[n] for goal in goals for n in list_neighbours(goal) if n in costs}
            if self._map.at in routes:
                goal = next(each for each in list_neighbours(self._map.at) if each in goals)
                if self._map.is_free(goal):  # a step would go onto it: come from farther away
                    yield from self._face_spot({cell for cell in goals if self._map.is_free(cell)})
                    return
                yield self._turn(goal)
            elif routes:
                yield self._step_to(min(routes, key=lambda cell: (routes[cell], cell)), before)
            elif not explore:
                raise ToolFailed(f"no {' or '.join(sorted(kinds))} is in reach")
            else:
                yield self._explore(kinds, costs, before)

    def _measure_routes(self) -> tuple[dict[Cell, float], dict[Cell, Cell]]:
        feared = {"zombie"} & self._feared | ({"skeleton"} if "arrow" in self._feared else set())
        return self._map.measure_routes([name for name, n in self._items.items() if n], feared)

    def _face_spot(self, spots: Collection[Cell], stations: Collection[str] = ()) -> Iterator[str]:
        """Have one of these free cells before it, with all stations in reach; a cell is faced by walking towards it."""
        while True:
            self._check_alive()
            seen, at = self._map, self._map.at
            if seen.facing in spots and seen.is_free(seen.facing) and self._reaches(at, stations):
                return
            costs, before = self._measure_routes()
            routes: dict[tuple[Cell, Cell], float] = {}
            for spot in spots:
                for u, v in DIRECTIONS if seen.is_free(spot) else ():
                    stand, start = (spot[0] - u, spot[1] - v), (spot[0] - 2 * u, spot[1] - 2 * v)
                    if start in costs and (seen.is_free(stand) or stand == at) and self._reaches(stand, stations):
                        routes[start, stand] = costs[start] + measure(start, stand)
            if not routes:
                raise ToolFailed("there is no free place for it in reach")
            start, stand = min(routes, key=lambda route: (routes[route], route))
            yield self._turn(stand) if start == at else self._step_to(start, before)

    def _stand_near(self, stations: Collection[str], what: str) -> Iterator[str]:
        """Stand where all these stations are in reach."""
        while not self._reaches(self._map.at, stations):
            self._check_alive()
            costs, before = self._measure_routes()
            routes = {cell: cost for cell, cost in costs.items() if self._reaches(cell, stations)}
            if not routes:
                raise ToolFailed(f"a {what} is made where a {' and a '.join(sorted(stations))} are in reach")
            yield self._step_to(min(routes, key=lambda cell: (routes[cell], cell)), before)

    def _reaches(self, cell: Cell, stations: Collection[str]) -> bool:
        return {*stations} <= {self._map.cells.get(each) for each in list_block(cell)}

    def _go_near(self, goal: Cell) -> str:
        costs, before = self._measure_routes()
        routes = {cell: cost for cell, cost in costs.items() if measure(cell, goal) <= NEAR}
        if not routes:
            raise ToolFailed("the plant is out of reach")
        return self._step_to(min(routes, key=lambda cell: (routes[cell], cell)), before)

    def _check_alive(self) -> None:
        if self._is_over:
            raise ToolFailed("this life is over")

    def _step_to(self, goal: Cell, before: Mapping[Cell, Cell]) -> str:
        """The next step on a route: dig or bridge what is before it, or go."""
        while before[goal] != self._map.at:
            goal = before[goal]
        if self._map.facing != goal or self._map.is_free(goal):
            return self._turn(goal)
        return "place_stone" if self._map.cells[goal] == "water" else "do"

    def _turn(self, cell: Cell) -> str:
        (x, y), (u, v) = self._map.at, cell
        return f"move_{DIRECTIONS[(u - x, v - y)]}"

    def _explore(self, kinds: Collection[str], costs: Mapping[Cell, float], before: Mapping[Cell, Cell]) -> str:
        """The next step to the nearest edge of what was seen, of the ground on which they are."""
        cells = self._map.cells
        ground = next((each for each in GROUNDS if GROUNDS[each] & {*kinds}), "")
        edges = {
            cell: cost + (AWAY if ground and (cells[cell] == "grass") != (ground == "grass") else 0.0)
            for cell, cost in costs.items()
            if cell != self._map.at and any(near not in cells for near in list_neighbours(cell))
        }
        known = {
            cell: costs[cell] for cell, (kind, _) in self._map.last_seen.items() if kind in kinds and cell in costs
        }
        if not (edges := known or edges):
            raise ToolFailed(f"no {' or '.join(sorted(kinds))} was seen, and there is nowhere left to look")
        if self._ahead.get(ground) not in edges:  # else what comes into view and goes out of it would turn it round
            self._ahead[ground] = min(edges, key=lambda cell: (edges[cell], cell))
        return self._step_to(self._ahead[ground], before)

    def _is_walled_in(self) -> bool:
        """Whether no foe can reach it: what it could walk to without digging is at most two cells."""
        near, seen = [self._map.at], {self._map.at}
        while near and len(seen) <= ROOM:
            for cell in list_neighbours(near.pop()):
                if self._map.cells.get(cell, "grass") in OPEN and cell not in seen:
                    seen.add(cell)
                    near.append(cell)
        return len(seen) <= ROOM

    def _wall_in(self) -> Iterator[str]:
        """Dig two cells into stone and close both ends."""
        if not self._is_walled_in():
            yield from self.collect("stone", ROOM)
        while not self._is_walled_in():
            self._check_alive()
            costs, before = self._measure_routes()
            rooms = {room: costs[room[0]] for room in self._list_rooms(costs)}
            if not rooms:
                yield self._explore({"stone"}, costs, before)
                continue
            inner, outer = min(rooms, key=lambda room: (rooms[room], room))
            if self._map.at != inner:
                yield self._step_to(inner, before)
                continue
            for cell in (outer, inner):  # each step faces the end that is to be closed
                while self._map.at != cell and not self._is_walled_in():
                    yield "do" if self._map.facing == cell and not self._map.is_free(cell) else self._turn(cell)
                if self._is_open(self._map.facing) and self._items["stone"]:
                    yield "place_stone"
            if not self._is_walled_in():
                raise ToolFailed("the walls do not close")

    def _list_rooms(self, costs: Mapping[Cell, float]) -> Iterator[tuple[Cell, Cell]]:
        """Two cells in a line that are reached, with closed sides."""
        cells = self._map.cells
        for inner in costs:
            for u, v in DIRECTIONS:
                outer = (inner[0] + u, inner[1] + v)
                sides = [(x + s * v, y + s * u) for x, y in (inner, outer) for s in (-1, 1)]
                walls = all(cells.get(side, "grass") not in OPEN for side in sides)
                if walls and cells.get(outer) in {*WALKABLE, "stone"} and outer not in self._map.creatures:
                    yield inner, outer
