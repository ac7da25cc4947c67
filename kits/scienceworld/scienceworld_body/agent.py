"""An agent that looks, walks, opens, takes and puts, by what it saw: what every skill of ScienceWorld is made of.

Its methods are generators of actions, one a step of the world. What it knows of places is what it has seen there.
"""

from collections.abc import Callable, Iterator
from typing import Any

from target_server.tool_body import Steps, ToolFailed

from scienceworld_body.reading import CARRIED, Room, Seen, read_room

Matches = Callable[[Seen], bool]
YOUNG = {"egg", "baby", "hatchling", "juvenile", "adult", "caterpillar", "pupa", "tadpole", "larva", "nymph"}
GROWN = {"seed", "seedling", "adult", "reproducing"}
PLANTS = ("tree", "plant", "seed")
VESSELS = ("metal pot", "tin cup", "ceramic cup", "glass cup", "glass jar", "jug", "bowl", "wood cup", "plastic cup")
PLAN = {
    "hallway": ("art studio", "bedroom", "greenhouse", "kitchen", "living room", "workshop"),
    "kitchen": ("bathroom", "hallway", "outside"), "outside": ("foundry", "greenhouse", "kitchen"),
    "greenhouse": ("hallway", "outside"), "bathroom": ("kitchen",), "foundry": ("outside",),
    "art studio": ("hallway",), "bedroom": ("hallway",), "living room": ("hallway",), "workshop": ("hallway",),
}  # fmt: skip
"""Which rooms of the house have doors to which: knowledge that is given; what is in them is not."""
HIVE = "bee hive"  # its bees fly out and away; it is opened where they are wanted
REFUSED = ("No known action", "Unknown action", "It's not clear", "The door is not", "I'm not sure", "can't be")


class Agent:
    """One agent in one world.

    Attributes:
        said: What the world answered to the latest action.
        facts: What was measured, by name.
        filled: How many objects are in what it put something in, by name.
        names: What an indefinite description (`animal`) was found to be.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self.room = Room("", (), {})
        self._forget()

    def _forget(self) -> None:
        self.said, self.facts, self.names, self.filled = "", dict[str, float](), dict[str, str](), dict[str, int]()
        self._doors, self._memory = {room: {*near} for room, near in PLAN.items()}, dict[str, Room]()

    def begin(self) -> None:
        """A world begins, of which nothing is known."""
        self._forget()
        self.look()

    def look(self) -> None:
        """See the room, which takes no time."""
        self.room = read_room(self._server.freeActionLook(), self._server.freeActionInventory())
        self._memory[self.room.name] = self.room
        self._doors[self.room.name] = {*self.room.doors}

    def act(self, action: str) -> None:
        """Do it, and see what has become of it."""
        self.said = str(self._server.step(action))
        self.look()

    def do(self, action: str, *places: str) -> Steps[str]:
        """One action; where its words fit several objects, the one in these places, the innermost first.

        Raises `ToolFailed` if refused.
        """
        yield action
        if self.said.startswith("Ambiguous request"):
            options = [line for line in self.said.splitlines() if line[:1].isdigit()]
            wanted = [f"in {place}" for place in places] + [f"(in {place}," for place in places[:1]]
            fits = [sum(each in line for each in wanted) for line in options]
            yield str(fits.index(max(fits)))
        if any(each in self.said for each in REFUSED):
            raise ToolFailed(f"{action}: {self.said.splitlines()[0]}")
        return self.said

    def refer(self, seen: Seen) -> str:
        """Words for it that fit nothing else in view, where there are such."""
        others = [each for each in self.room.seen if each.name == seen.name and each.inside != seen.inside]
        return f"{seen.name} in {seen.inside[0]}" if others and seen.inside else seen.name

    def enter(self, room: str) -> Steps[str]:
        """Walk to a room, and open what is closed in it."""
        while self.room.name != room:
            step = self._find_step({room})
            if not step:
                raise ToolFailed(f"no door leads to a {room}")
            yield from self._pass(step)
        yield from self._open_all()
        return room

    def find(self, matches: Matches, what: str) -> Iterator[str]:
        """Be where such an object is in view: here, where one was seen, or in rooms not seen yet, the nearest first."""
        yield from self._open_all()
        while not any(map(matches, self.room.seen)):
            known = {name for name, room in self._memory.items() if any(map(matches, room.seen))}
            step = self._find_step(known) or self._find_step(self._list_unseen())
            if not step:
                raise ToolFailed(f"{what} was not found in {len(self._memory)} rooms")
            yield from self._pass(step)
            yield from self._open_all()

    def get(self, matches: Matches, what: str) -> Seen:
        """Such an object in view, one that is carried first; raises `ToolFailed`."""
        found = sorted(filter(matches, self.room.seen), key=lambda each: CARRIED not in each.inside)
        if not found:
            raise ToolFailed(f"no {what} is in view")
        return found[0]

    def fetch(self, what: str) -> Steps[str]:
        """Find it and carry it."""
        yield from self.find(self.match(what), what)
        seen = self.get(self.match(what), what)
        if CARRIED not in seen.inside:
            yield from self.do(f"pick up {seen.name}", *seen.inside[:1])
        return seen.name

    def put(self, what: str, into: str) -> Steps[str]:
        """Move an object that is in view into another; `filled` counts what is in that then."""
        seen = self.get(self.match(what), what)
        said = yield from self.do(f"move {seen.name} to {into}", *seen.inside[:1])
        self.filled[into] = len(self.list_inside(into))
        return said

    def match(self, what: str) -> Matches:
        """Whether an object is one of this name or kind; of a kind the one that was chosen before."""
        name = self.names.get(what, what)
        if what in KINDS:  # an egg may have hatched since
            return KINDS[what] if name == what else lambda seen: is_of(seen, name)
        return lambda seen: f" {spell(seen.name)}".endswith(f" {spell(name)}")

    def list_inside(self, container: str) -> list[Seen]:
        """What is in a container in view, at any depth."""
        return [each for each in self.room.seen if container in each.inside]

    def _pass(self, room: str) -> Iterator[str]:
        if not self.room.doors[room]:
            yield from self.do(f"open door to {room}")
        yield from self.do(f"go to {room}")

    def _open_all(self) -> Iterator[str]:
        for each in self.room.seen:
            if each.has("door is closed") and each.name != HIVE:
                yield from self.do(f"open {each.name}")

    def _list_unseen(self) -> set[str]:
        return {room for doors in self._doors.values() for room in doors} - self._memory.keys()

    def _find_step(self, rooms: set[str]) -> str:
        """The next room on the shortest walk to one of these; empty where there is none."""
        first, queue = {self.room.name: ""}, [self.room.name]
        for room in queue:
            for near in sorted(self._doors.get(room, ())):
                if near not in first:
                    first[near] = first[room] or near
                    queue.append(near)
        return next((first[room] for room in queue if room in rooms), "")


def spell(name: str) -> str:
    """A name as it is compared: without capitals and hyphens."""
    return name.lower().replace("-", " ")


def is_of(seen: Seen, species: str) -> bool:
    """Whether it is an individual of a species, or a part of one."""
    return f" {spell(species)} " in f" {spell(seen.name)} "


def is_plant(seen: Seen) -> bool:
    """Whether it grows."""
    return seen.stage in GROWN and seen.name.endswith(PLANTS)


def is_animal(seen: Seen) -> bool:
    """Whether it is said to be in a stage of an animal's life."""
    return seen.stage in YOUNG and not seen.name.endswith(PLANTS)


PORTABLE = {"axe", "shovel", "lighter", "stopwatch", "thermometer", *VESSELS}
KINDS: dict[str, Matches] = {
    "animal": lambda seen: is_animal(seen) and not is_of(seen, "bee"),
    "plant": is_plant,
    "living thing": lambda seen: (is_animal(seen) and not is_of(seen, "bee")) or is_plant(seen),
    "non living thing": lambda seen: not seen.stage and not seen.inside and seen.name in PORTABLE,
}
"""What is meant by an indefinite description; a bee flies out of the hand."""
