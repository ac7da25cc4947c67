"""A small world of text: a maker who walks, gathers, makes and eats. It has no joints, only tools.

The same seed gives the same world, and the same calls the same bits. Nothing is drawn.
"""

import json
import random

from target_server.body import Entity, State
from target_server.server import main
from target_server.tool_body import Tool, ToolBody, ToolFailed
from target_server.wire import Refusal

PLACES = {"tree": (0, 0), "bench": (4, 1), "rock": (8, 0), "bush": (2, 4)}
SOURCES = {"wood": ("tree", ""), "stone": ("rock", "pickaxe"), "berry": ("bush", "")}  # where, and with which tool
RECIPES = {  # how many come of what, and where
    "plank": (4, {"wood": 1}, ""),
    "stick": (4, {"plank": 2}, ""),
    "pickaxe": (1, {"plank": 3, "stick": 2}, "bench"),
}
FOOD_MAX, HEALTH_MAX, DAY = 9, 9, 200
VIEW = 6  # cells
STEPS_MAX = 1000  # of one tool


class Workbench(ToolBody):
    """An action is a function of no arguments, carried out in one step."""

    target = "maker"
    driver = "workbench"
    step_s = 0.1
    has_truth = True

    def __init__(self):
        self._reset(0)
        places, items = {"place": "string"}, {"item": "string"}
        self.toolbox = {
            "walk_to": Tool(self.walk_to, places, {"place": tuple(PLACES)}),
            "gather": Tool(self.gather, items | {"amount": "integer"}, {"item": tuple(SOURCES)}, {"amount": 1}),
            "make": Tool(self.make, items, {"item": tuple(RECIPES)}),
            "eat": Tool(self.eat),
            "wait": Tool(self.wait, {"steps": "integer"}),
        }

    def _reset(self, seed):
        self._steps, self._at, self._inventory = 0, (1, 1), {}
        self._food, self._health, self._random = FOOD_MAX, HEALTH_MAX, random.Random(seed)

    @property
    def time_s(self):
        return self._steps * self.step_s

    def load(self, scene, seed, snapshot):
        if not snapshot:
            return self._reset(seed)
        try:
            steps, at, inventory, food, health, (version, numbers, gauss) = json.loads(snapshot)
            self._random.setstate((version, tuple(numbers), gauss))
            self._at = (int(at[0]), int(at[1]))
            self._inventory = {str(name): int(n) for name, n in inventory.items()}
            self._steps, self._food, self._health = int(steps), int(food), int(health)
        except (ValueError, TypeError, AttributeError) as error:
            raise Refusal("MALFORMED", f"no snapshot of a workbench: {error}") from error

    def snapshot(self):
        state = (self._steps, self._at, self._inventory, self._food, self._health, self._random.getstate())
        return "application/json", json.dumps(state).encode()

    def read(self):
        return State(
            base=(*map(float, self._at), 0.0),
            inventory=dict(sorted(self._inventory.items())),
            vitals={"food": float(self._food), "health": float(self._health)},
            nearby=tuple(name for name in PLACES if self._is_near(name)),
            daylight=1.0 if self._steps % DAY < DAY // 2 else 0.2,
        )

    def list_entities(self):
        x, y = self._at
        seen = {name: (u, v) for name, (u, v) in PLACES.items() if abs(u - x) + abs(v - y) <= VIEW}
        box = {"kind": "box", "size_m": (0.5, 0.5, 0.5), "pose": {}}
        return [
            Entity(name, name, (float(u), float(v), 0.0), movable=False, shapes=(box,)) for name, (u, v) in seen.items()
        ]

    def act(self, action):
        self._steps += 1
        if action is not None:
            action()
        if self._steps % 25 == 0:
            self._food = max(self._food - 1, 0)
            self._health = max(self._health - 1, 0) if not self._food else min(self._health + 1, HEALTH_MAX)

    def walk_to(self, place):
        """Tool: go to a place that is in view, one cell a step."""
        if place not in [each.name for each in self.list_entities()]:
            raise ToolFailed(f"{place} is not in view")
        while not self._is_near(place):
            yield lambda: self._move(PLACES[place])
        return f"stands beside {place}"

    def gather(self, item, amount):
        """Tool: take so many from where they grow; a try may fail."""
        place, tool = SOURCES[item]
        if not self._is_near(place):
            raise ToolFailed(f"there is no {item} here; it is found at a {place}")
        if tool and not self._inventory.get(tool):
            raise ToolFailed(f"{item} needs a {tool}")
        wanted = self._inventory.get(item, 0) + amount
        for _ in range(STEPS_MAX):
            if self._inventory.get(item, 0) >= wanted:
                return f"has {wanted} {item}"
            yield lambda: self._add(item, self._random.random() < 0.6)
        raise ToolFailed(f"{amount} {item} were not found in {STEPS_MAX} steps")

    def make(self, item):
        """Tool: make an item by its recipe."""
        amount, parts, place = RECIPES[item]
        if place and not self._is_near(place):
            raise ToolFailed(f"a {item} is made at a {place}")
        if lacking := [f"{n} {part}" for part, n in parts.items() if self._inventory.get(part, 0) < n]:
            raise ToolFailed(f"a {item} needs {', '.join(lacking)}")
        yield lambda: self._craft(item)
        return f"made {amount} {item}"

    def eat(self):
        """Tool: eat a berry."""
        if not self._inventory.get("berry"):
            raise ToolFailed("there is no berry to eat")
        yield self._eat
        return "ate a berry"

    def wait(self, steps):
        """Tool: do nothing."""
        for _ in range(steps):
            yield None
        return f"waited {steps} steps"

    def _is_near(self, place):
        return sum(abs(a - b) for a, b in zip(self._at, PLACES[place], strict=True)) <= 1

    def _move(self, to):
        (x, y), (u, v) = self._at, to
        self._at = (x + (u > x) - (u < x), y) if x != u else (x, y + (v > y) - (v < y))

    def _add(self, item, amount):
        left = self._inventory.get(item, 0) + amount
        self._inventory.pop(item, None)
        if left:
            self._inventory[item] = left

    def _craft(self, item):
        amount, parts, _ = RECIPES[item]
        for part, n in parts.items():
            self._add(part, -n)
        self._add(item, amount)

    def _eat(self):
        self._add("berry", -1)
        self._food = min(self._food + 3, FOOD_MAX)


if __name__ == "__main__":
    main(Workbench)
