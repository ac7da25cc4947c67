"""A game of NetHack as a body without joints: tools that explore, go down, fight and pray by what the screen shows.

    python -m nle_body < KEY

Depth and level are on the screen; progress by BALROG's metric is not, and stays with who measures: how a game stands is
an outcome when a session ends.
"""

import json
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from nle import nethack
from target_server.body import Entity, State, append_outcome
from target_server.procedures import Call
from target_server.tool_body import Steps, Tool, ToolBody, ToolFailed
from target_server.wire import Refusal

from nle_body.game import ESCAPE, Game
from nle_body.level_map import DIRECTIONS, UNSEEN, Cell, Level, name_monster

STRIKE, KICK, APPLY, EAT, PICK_UP, DOWN, UP = "F", "\x04", "a", "e", ",", ">", "<"  # keys of the game
SEARCH, REST, PRAY, EAT_CORPSE = "10s", "20s", chr(240) + "y", "ey"
TURNS = {key: turn for turn, key in DIRECTIONS.items()}
FIRST_PRAYER, NEXT_PRAYER = 120, 800  # turns after which a god is likely to help
KICKS, DIGS, SEARCHES, VIEW = 15, 30, 60, 8  # tries; and the cells within which a foe is near
MINES = 2  # the branch of gnomes and dwarves, hostile to other races
RAW, DIGGERS = ("corpse", "egg", "tin", "glob"), ("pick-axe", "mattock", "broad pick")  # spoilt or slow food; tools


class NetHackBody(ToolBody[str]):
    """One game; after its end nothing moves any more, and its tools say so."""

    target, driver, step_s, has_truth = "adventurer", "nle", 0.1, True

    def __init__(self) -> None:
        tools = {
            "descend": self.descend, "climb": self.climb, "explore": self.explore, "search": self.search,
            "dig_down": self.dig_down, "fetch_digger": self.fetch_digger, "attack": self.attack, "eat": self.eat,
            "pray": self.pray,
        }  # fmt: skip
        self.toolbox: Mapping[str, Tool[str]] = {
            **{name: Tool(partial(self._use, run)) for name, run in tools.items()},
            "rest": Tool(partial(self._use, self.rest), {"share": "number"}),
        }
        self._begin(0)

    def _begin(self, seed: int) -> None:
        self._seed, self._game, self._ticks = seed, Game(seed), 0
        self._levels = defaultdict[tuple[int, int], Level](Level)
        self._next_prayer = FIRST_PRAYER
        self._level = self._levels[self._game.place]
        self._level.look(self._game.glyphs, self._game.at)

    def _use(self, run: Callable[..., Iterator[str]], **given: float) -> Steps[str]:
        for keys in run(**given):
            if self._game.is_over:
                raise ToolFailed("the game is over")
            yield keys
        return self._game.message

    @property
    def time_s(self) -> float:
        return self._ticks * self.step_s

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        try:
            seed, keys, ticks = json.loads(snapshot) if snapshot else (seed, (), 0)
            self._begin(int(seed))
            for each in keys:
                self.act(str(each))
            self._ticks = int(ticks)
        except (ValueError, TypeError, KeyError) as error:
            raise Refusal("MALFORMED", f"no game of NetHack: {error}") from error

    def snapshot(self) -> tuple[str, bytes]:
        """The seed and all keys since: a game is played again from its beginning, and remembered the same."""
        return "application/json", json.dumps((self._seed, self._game.keys, self._ticks)).encode()

    def call(self, procedure: str, goal: Mapping[str, Any]) -> Call:
        if self._game.is_asked:  # a tool before was stopped
            self._game.press(ESCAPE)
        return super().call(procedure, goal)

    def act(self, action: str | None) -> None:
        self._ticks += 1
        if action is None:
            return
        level, game, place = self._level, self._game, self._game.place
        game.press(action)
        self._level = self._levels[game.place]
        if action in (STRIKE + each for each in TURNS) or action in TURNS:
            self._learn_of_step(level, level.at, TURNS[action[-1]])
        elif action == SEARCH:
            level.searched.update(level.iter_near(level.at))
            level.failed.clear()
        elif action == PICK_UP:
            level.searched[level.at] += 1
        elif action == EAT_CORPSE:
            level.killed.pop(level.at, None)
        elif action == PRAY:
            self._next_prayer = game.turn + NEXT_PRAYER
        elif action == (DOWN if place == game.place else UP):  # it leads nowhere, or came from astray
            self._level.shunned.add(game.at)
        self._level.look(game.glyphs, game.at)

    def _learn_of_step(self, level: Level, at: Cell, turn: Cell) -> None:
        cell = (at[0] + turn[0], at[1] + turn[1])
        if self._game.is_asked:
            level.peaceful.add(level.show(cell))
        elif "You kill" in self._game.message:
            level.killed[cell] = self._game.turn
        elif self._level is level and self._game.at == at:
            level.failed[at, cell] += 1

    def read(self) -> State:
        game = self._game
        health = 0 if game.is_over else game.health
        vitals = {
            "health": float(health),
            "health_share": health / max(1, game.health_max),
            "in_peril": float(health <= 5 or health * 7 <= game.health_max),
            "astray": float(game.place[0] == MINES and not game.is_at_home),
            "may_pray": float(game.turn >= self._next_prayer),
            "hunger": float(game.hunger),
            "food_near": float(bool(self._list_food())),
            "calm": float(not self._level.list_foes(1)),
            "foes_near": float(len(self._level.list_foes(VIEW))),
            "has_digger": float(bool(self._find_digger())),
            "depth": float(game.place[1]),
            "deepest": float(game.depth),
            "level": float(game.level),
            "turn": float(game.turn),
        }
        carried = {"_".join(text.split()): 1 for _, text in game.items.values()}
        known = ["stairs_down"][: len(self._level.down)]
        return State(base=(float(game.at[0]), float(game.at[1]), 0.0), inventory=carried, vitals=vitals, nearby=known)

    def list_entities(self) -> Sequence[Entity]:
        """Monsters in view, and the stairs that were seen."""
        found = [(name_monster(self._level.show(cell)), cell) for cell in self._level.list_foes(80)]
        found += [("stairs_down", cell) for cell in sorted(self._level.down)]
        return [
            Entity(f"{kind.replace(' ', '_')}_{n}", kind, (float(x), float(y), 0.0), movable=False)
            for n, (kind, (x, y)) in enumerate(found)
        ]

    def note_end(self, session: str) -> None:
        """How the game stands, for who measures."""
        game = self._game
        append_outcome(
            session, seed=self._seed, steps=game.steps, turns=game.turn, depth=game.depth, level=game.level,
            branch=game.place[0], is_over=game.is_over, end=game.end,
        )  # fmt: skip

    def descend(self) -> Iterator[str]:
        """Tool: go to stairs, a ladder or a hole that was seen, and down."""
        yield from self._leave(self._level.down, DOWN)

    def climb(self) -> Iterator[str]:
        """Tool: go to the stairs up and up, and shun the stairs that led here."""
        yield from self._leave(self._level.up, UP)

    def _leave(self, exits: set[Cell], key: str) -> Iterator[str]:
        place = self._game.place
        yield from self._walk(exits)
        if self._game.place == place:
            yield key
        if self._game.place == place:
            raise ToolFailed(f"it leads nowhere: {self._game.message}")

    def explore(self) -> Iterator[str]:
        """Tool: walk to the edges of what was seen, until stairs or a tool for digging are in reach."""
        level = self._level
        while self._level is level:
            if self._is_reached(level.down) or (self._is_reached(self._list_diggers()) and not self._find_digger()):
                break
            if not (route := level.find_route(level.list_edges())):
                raise ToolFailed("there is nowhere left to look")
            yield from self._step(route[0])

    def search(self) -> Iterator[str]:
        """Tool: look for hidden doors and passages where they are likeliest, until something new is seen."""
        level = self._level
        for _ in range(SEARCHES):
            yield from self._walk({level.choose_search(level.measure_routes()[0])})
            edges = level.list_edges()
            yield SEARCH
            if level.list_edges() - edges or self._level is not level:
                return
        raise ToolFailed("nothing is hidden here, as far as it was searched")

    def dig_down(self) -> Iterator[str]:
        """Tool: dig a hole through the floor, and fall."""
        place = self._game.place
        for _ in range(DIGS):
            if not (letter := self._find_digger()):
                raise ToolFailed("it carries nothing that digs")
            yield APPLY + letter + DOWN
            if self._game.place != place:
                return
            if "too hard" in self._game.message or "enough room" in self._game.message:
                yield from self._step(self._level.find_route([*self._level.iter_near(self._game.at)])[0])
        raise ToolFailed(f"the floor holds: {self._game.message}")

    def fetch_digger(self) -> Iterator[str]:
        """Tool: pick up what digs, where one is in view."""
        yield from self._walk(self._list_diggers())
        yield PICK_UP
        if not self._find_digger():
            raise ToolFailed(f"it was not picked up: {self._game.message}")

    def attack(self) -> Iterator[str]:
        """Tool: strike what is beside it; what turns out to be at peace is left alone."""
        while foes := self._level.list_foes(1):
            is_unseen = (
                name_monster(self._level.show(foes[0])) in UNSEEN
            )  # of any other the game asks where it is at peace
            yield STRIKE * is_unseen + self._turn(foes[0])
            if self._game.is_asked:
                yield ESCAPE

    def rest(self, share: float) -> Iterator[str]:
        """Tool: rest until so much of its health is back, or something comes."""
        while self._game.health < share * self._game.health_max and not self._level.list_foes(VIEW):
            yield REST

    def eat(self) -> Iterator[str]:
        """Tool: eat a fresh corpse that is near, or of what it carries when it is hungry."""
        if corpses := self._list_food():
            yield from self._walk(corpses)
            yield EAT_CORPSE
            return
        food = [each for each, (kind, text) in self._game.items.items() if kind == nethack.FOOD_CLASS]
        food = [each for each in food if not any(word in self._game.items[each][1] for word in RAW)]
        if not food:
            raise ToolFailed("it carries no food")
        yield EAT + food[0]
        if "eat it" in self._game.message:  # what is on the floor
            yield ESCAPE + EAT + "n" + food[0]

    def pray(self) -> Iterator[str]:
        """Tool: pray."""
        yield PRAY

    def _list_food(self) -> set[Cell]:
        food = self._level.list_food(self._game.turn) if self._game.hunger else set[Cell]()
        return {cell for cell in food if self._is_reached({cell})}

    def _find_digger(self) -> str:
        """The letter of what it carries that digs; empty where that is none."""
        items = self._game.items.items()
        return next((n for n, (_, text) in items if any(each in text for each in DIGGERS)), "")

    def _list_diggers(self) -> list[Cell]:
        return [cell for cell in sorted(self._level.list_diggers()) if not self._level.searched[cell]]

    def _is_reached(self, goals: Collection[Cell]) -> bool:
        return self._level.at in goals or bool(goals and self._level.find_route(goals))

    def _walk(self, goals: Collection[Cell]) -> Iterator[str]:
        """Walk onto the nearest of these cells; the routes are measured at each step."""
        level = self._level
        while self._level is level and level.at not in goals:
            if not (route := level.find_route(goals)):
                raise ToolFailed("no route leads there")
            yield from self._step(route[0])

    def _step(self, cell: Cell) -> Iterator[str]:
        """One step, or what opens it: a locked door is kicked in; a step that fails is remembered."""
        level, key = self._level, self._turn(cell)
        yield key
        if self._game.is_asked:
            yield ESCAPE
        for _ in range(KICKS if "locked" in self._game.message else 0):
            yield KICK + key
            if "WHAM" not in self._game.message or self._level is not level:
                break

    def _turn(self, cell: Cell) -> str:
        (x, y), (u, v) = self._level.at, cell
        return DIRECTIONS[u - x, v - y]
