"""A player of Luanti as a body without joints: tools that look, walk, dig, craft, smelt and fight by what was seen.

    python -m luanti_body < KEY

What the player does is done by the game's own functions, in a server of its own; what it knows are the nodes along
lines of view up to 16 nodes long, now or before, and the game's book. It needs no light to see. The clock of the day
goes by the steps that its actions take; liquids, leaves and fire go by the server's own clock.
"""

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from target_server.body import Entity, State
from target_server.tool_body import Steps, Tool, ToolBody, ToolFailed
from target_server.wire import Refusal

from luanti_body.agent import STEP_S, Action, Agent
from luanti_body.book import FUEL, FUEL_S, FURNACE, name_item
from luanti_body.terrain import SIDES, Cell
from luanti_body.world import World, open_world

DIRECTIONS = {"east": (1, 0), "north": (0, 1), "west": (-1, 0), "south": (0, -1)}
LOOK_S, CRAFT_S, EAT_S, STRIKE_S, SMELT_S = 1.0, 0.5, 1.0, 1.0, 1.0
CLOCK_S = 5.0  # after which the day is brought up to date at rest
FAILS = 12  # of finding or reaching one, in a row
SEEN_MAX = 2000  # nodes of a kind of which the nearest is reported


class LuantiBody(ToolBody[Action]):
    """One player; after its death nothing moves any more, and its tools say so."""

    target, driver, step_s, has_truth = "player", "luanti", STEP_S, True

    def __init__(self) -> None:
        what, amount = {"what": "string"}, {"what": "string", "amount": "integer"}
        tunnel = {"direction": "string", "length": "integer"}
        self.toolbox: Mapping[str, Tool[Action]] = {
            "look": Tool(self.look),
            "walk_to": Tool(self.walk_to, what),
            "dig": Tool(self.dig, what),
            "dig_tunnel": Tool(self.dig_tunnel, tunnel, {"direction": tuple(DIRECTIONS)}),
            "descend_to": Tool(self.descend_to, {"height": "integer"}),
            "collect": Tool(self.collect, amount),
            "craft": Tool(self.craft, amount),
            "smelt": Tool(self.smelt, amount),
            "place": Tool(self.place, what),
            "equip": Tool(self.equip, what),
            "eat": Tool(self.eat, what),
            "attack": Tool(self.attack),
            "wait": Tool(self.wait, {"steps": "integer"}),
        }
        self._world: World | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._steps, self._clock_s = 0, 0.0

    @property
    def time_s(self) -> float:
        return self._steps * self.step_s

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        if snapshot:
            raise Refusal("REQUEST_INVALID", "a world of Luanti begins at its seed")
        self.close()
        self._folder = tempfile.TemporaryDirectory(prefix="luanti-")
        self._world, start = open_world(seed, Path(self._folder.name), self.beat)
        self._world.begin(start)
        self._agent = Agent(self._world.link, heading=seed)
        self._steps, self._clock_s = 0, 0.0

    def close(self) -> None:
        if self._world is not None:
            self._world.close()
        if self._folder is not None:
            self._folder.cleanup()
        self._world = self._folder = None

    def act(self, action: Action) -> None:
        self._steps += 1
        self._clock_s += self.step_s
        if self._world is not None and (action is not None or self._clock_s >= CLOCK_S):
            self._agent.act(action, self._clock_s)
            self._clock_s = 0.0

    def read(self) -> State:
        if self._world is None:
            return State(inventory={}, vitals={}, nearby=())
        agent = self._agent
        x, y, z = agent.at
        kinds = {name_item(name): n for name, n in agent.items.items()}
        kinds |= {kind: agent.count(kind) for kind in agent.book.groups_used}
        near = {agent.terrain.cells.get((x + u, y + v, z + w)) for u, w in SIDES for v in (0, 1)}
        return State(
            base=(float(x), float(z), 0.0),
            inventory={name: n for name, n in sorted(kinds.items()) if n},
            vitals={"health": agent.health, "breath": agent.breath, "height": float(y), "light": agent.light},
            nearby=(name_item(FURNACE),) if FURNACE in near else (),
            daylight=max(0.0, math.sin(math.tau * (agent.day - 0.25))),
        )

    def list_entities(self) -> Sequence[Entity]:
        """Creatures in view, and the nearest of each kind of node that was seen and is no mass of the ground."""
        if self._world is None:
            return ()
        places = {name: cells for name, cells in self._agent.terrain.places.items() if 0 < len(cells) < SEEN_MAX}
        nearest = [(name, name, self._agent.list_nearest(cells, 1)[0]) for name, cells in sorted(places.items())]
        nearest += [(f"{name}_{n}", name, at) for n, (name, at) in enumerate(self._agent.creatures)]
        return [
            Entity(name_item(name), name_item(kind), (float(x), float(z), float(y)), movable=False)
            for name, kind, (x, y, z) in nearest
        ]

    def look(self) -> Steps[Action]:
        """Tool: look around, for a second."""
        yield from self._agent.spend(LOOK_S)
        return f"{len(self._agent.terrain.cells)} nodes are known"

    def walk_to(self, what: str) -> Steps[Action]:
        """Tool: walk and dig until the nearest seen node of a kind can be reached."""
        yield from self._agent.travel(self._agent.list_seen(what), to_reach=True)
        return f"can reach a {what}"

    def dig(self, what: str) -> Steps[Action]:
        """Tool: dig the nearest seen node of a kind."""
        yield from self._agent.dig_nearest(self._agent.list_seen(what))
        return f"dug a {what}"

    def dig_tunnel(self, direction: str, length: int) -> Steps[Action]:
        """Tool: go straight on so many nodes, through what is there."""
        (u, w), (x, y, z) = DIRECTIONS[direction], self._agent.at
        yield from self._agent.travel({(x + u * length, y, z + w * length)})
        return f"went {length} nodes {direction}"

    def descend_to(self, height: int) -> Steps[Action]:
        """Tool: dig down, or climb, to a height."""
        x, _, z = self._agent.at
        yield from self._agent.travel({(x, height, z)})
        return f"stands at {height}"

    def collect(self, what: str, amount: int) -> Steps[Action]:
        """Tool: carry so many of a kind, from where it was seen or is found."""
        agent, terrain = self._agent, self._agent.terrain
        agent.list_items(what)
        if not (sources := agent.book.list_sources(what)):
            raise ToolFailed(f"{what} is not found in the ground")
        fails, given_up = 0, set[Cell]()
        while agent.count(what) < amount:
            if not any(map(agent.can_dig, sources)):
                raise ToolFailed(f"{what} needs another tool")
            seen = {cell for name in sources if name in terrain.times for cell in terrain.places[name]} - given_up
            try:
                yield from agent.dig_nearest(seen) if seen else agent.search(sources)
                fails = 0
            except ToolFailed as failure:
                fails += 1
                given_up |= {*agent.list_nearest(seen)}
                agent.heading += 1
                if fails > FAILS or agent.health <= 0:
                    raise ToolFailed(f"{amount} {what} were not found: {failure}") from failure
        return f"carries {agent.count(what)} {what}"

    def craft(self, what: str, amount: int) -> Steps[Action]:
        """Tool: make so many of a kind by a recipe of the game."""
        agent = self._agent
        while agent.count(what) < amount:
            refusals = []
            for item in agent.list_items(what):
                try:
                    yield from agent.do(CRAFT_S, name="craft", item=item)
                    break
                except ToolFailed as refusal:
                    refusals.append(str(refusal))
            else:
                raise ToolFailed("; ".join(refusals[:3]))
        return f"carries {agent.count(what)} {what}"

    def smelt(self, what: str, amount: int) -> Steps[Action]:
        """Tool: make so many of a kind in a furnace, which is set up for it and taken along again."""
        agent = self._agent
        cooked = [each for item in agent.list_items(what) for each in agent.book.recipes.get(item, ())]
        cooked = [each for each in cooked if each["method"] == "cooking" and agent.items.get(each["items"][0])]
        if not cooked:
            raise ToolFailed(f"carries nothing that becomes {what} in a furnace")
        (source,), seconds = cooked[0]["items"], cooked[0]["time"]
        times = math.ceil((amount - agent.count(what)) / int(cooked[0]["output"].partition(" ")[2] or 1))
        fuel = math.ceil(times * seconds / FUEL_S)
        if agent.items[source] < times or agent.items.get(FUEL, 0) < fuel:
            raise ToolFailed(f"{times} {source} and {fuel} {FUEL} are needed")
        yield from agent.set_up(FURNACE)
        spot = agent.spot
        yield from agent.do(CRAFT_S, name="furnace", at=spot, source=f"{source} {times}", fuel=f"{FUEL} {fuel}")
        for _ in range(math.ceil(times * seconds / SMELT_S) + 2):
            yield from agent.do(SMELT_S, name="furnace", at=spot, seconds=SMELT_S)
        yield from agent.do(CRAFT_S, name="furnace", at=spot, take=True)
        yield from agent.dig(spot)
        if agent.count(what) < amount:
            raise ToolFailed(f"carries {agent.count(what)} {what} afterwards")
        return f"carries {agent.count(what)} {what}"

    def place(self, what: str) -> Steps[Action]:
        """Tool: put a node beside it."""
        item = next((each for each in self._agent.list_items(what) if self._agent.items.get(each)), "")
        if not item:
            raise ToolFailed(f"carries no {what}")
        yield from self._agent.set_up(item)
        return f"placed {item}"

    def equip(self, what: str) -> Steps[Action]:
        """Tool: take an item into the hand, or put on armour."""
        yield from self._agent.do(CRAFT_S, name="equip", item=self._agent.list_items(what)[0])
        return f"has {what} at hand"

    def eat(self, what: str) -> Steps[Action]:
        """Tool: eat an item."""
        yield from self._agent.do(EAT_S, name="eat", item=self._agent.list_items(what)[0])
        return f"ate {what}"

    def attack(self) -> Steps[Action]:
        """Tool: strike the creature in reach."""
        yield from self._agent.do(STRIKE_S, name="attack")
        return f"struck {self._agent.answer['struck']}"

    def wait(self, steps: int) -> Steps[Action]:
        """Tool: do nothing."""
        yield from self._agent.spend(steps * self.step_s)
        return f"waited {steps} steps"
