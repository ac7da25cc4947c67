"""An independent check of plans: sessions as changes of poses, judged by geometry and the predicates of verdicts.

It shares no code with the planner. An object is put where boxes find room, a drawer carries what is in it, and before a
object is taken nothing may be on it and nothing may hide it. What a session does is read from its skill's name.
"""

import itertools
import math
import random
from collections.abc import Mapping, Sequence
from typing import Any

import networkx as nx
from msgspec.structs import replace

from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.geometry import Pose, Vector, to_child, to_parent
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.entity_geometry import AXES, compute_extent
from phyagentos.protocol.world.environment import Entity, Environment
from phyagentos.protocol.world.mechanisms import compute_motion
from phyagentos.protocol.world.truth import Truth

GAP_M = 0.002  # between two objects side by side
STEP_M = 0.005
ORDERS_MAX = 24  # linear orders of one graph that are tried


class Invalid(Exception):
    """A session that cannot be carried out as its plan says."""


class Kinematics:
    """A world that sessions change."""

    def __init__(self, world: Environment) -> None:
        self.world, self.initial = world, world

    def holds(self, text: str, target: str = "") -> bool:
        """Whether a predicate is true now."""
        view = View(now=self.world, initial=self.initial, target=target or None)
        return parse_predicate(text).evaluate(view).truth is Truth.TRUE

    def list_movable(self) -> list[str]:
        """Objects that a hand can carry."""
        return [n for n, e in self.world.entities.items() if e.movable and not e.mechanism and not e.part_of]

    def take(self, name: str) -> None:
        """Raises Invalid where it cannot be taken."""
        for other in self.list_movable():
            if other != name and self.holds(f"on({other}, {name})"):
                raise Invalid(f"{other} is on {name}")
        for place, entity in self.world.entities.items():
            if entity.mechanism and entity.interior and self.holds(f"inside({name}, {place})"):
                self._need_open(place)

    def put_inside(self, name: str, place: str) -> None:
        """Into a vessel or region, where it finds room."""
        self.take(name)
        holder, region = self.world.entities.get(place), self.world.regions.get(place)
        if holder is not None and holder.interior is not None:
            if holder.mechanism:
                self._need_open(place)
            self._put(name, holder.pose, holder.interior.center_m, holder.interior.half_m, place)
        elif region is not None:
            self._put(name, region.pose, (0.0, 0.0, 0.0), region.half_m, place)
        else:
            raise Invalid(f"{place} takes nothing in")

    def put_on(self, name: str, support: str) -> None:
        """Onto an object: in the middle of a movable one, where there is room on a fixed one."""
        self.take(name)
        below = self.world.entities[support]
        (left, right), (back, front), (_, top) = (compute_extent(below, axis) for axis in AXES)
        middle = ((left + right) / 2, (back + front) / 2, top)
        if below.movable and any(self.holds(f"on({o}, {support})") for o in self.list_movable() if o != name):
            raise Invalid(f"{support} is not clear")
        half = (0.001, 0.001, 0.0) if below.movable else ((right - left) / 2, (front - back) / 2, 0.0)
        self._put(name, below.pose, middle, half, support, may_overhang=True)

    def put_at(self, name: str, point: Sequence[float], support: str) -> None:
        """To a point of a support."""
        self.take(name)
        below = self.world.entities[support]
        top = below.pose.position_m[2] + compute_extent(below, AXES[2])[1]
        self._put(name, Pose((point[0], point[1], top)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "", may_overhang=True)

    def turn_joint(self, name: str, share: float) -> None:
        """Open or close; what is inside and what is fixed to it comes along."""
        entity = self.world.entities[name]
        assert entity.mechanism is not None
        inside = [each for each in self.list_movable() if entity.interior and self.holds(f"inside({each}, {name})")]
        parts = [each.name for each in self.world.entities.values() if each.part_of == name]
        shift = compute_motion(entity.mechanism, entity.mechanism.travel * (share - (entity.joint or 0.0)))[:3, 3]
        moved = {}
        for each in (name, *inside, *parts):
            old = self.world.entities[each]
            x, y, z = (float(a + b) for a, b in zip(old.pose.position_m, shift, strict=True))
            moved[each] = replace(old, pose=Pose((x, y, z), old.pose.quaternion_wxyz))
        moved[name] = replace(moved[name], joint=share)
        self.world = replace(self.world, entities=self.world.entities | moved)
        for each in self.list_movable():
            if each not in inside and any(_overlap(self.world.entities[each], moved[m]) for m in (name, *parts)):
                raise Invalid(f"{each} is in the way of {name}")

    def execute(self, skill: str, arguments: Mapping[str, Any]) -> None:
        """One session."""
        item = arguments.get("object", "")
        match skill:
            case "pick_and_place" | "insert":
                self.put_inside(item, arguments.get("destination") or arguments["socket"])
            case "stack" | "unstack":
                self.put_on(item, arguments["support"])
            case "put_at" | "set_aside":
                self.put_at(item, arguments["to"], arguments["support"])
            case "open_drawer" | "close_drawer":
                if self.world.entities[arguments["handle"]].part_of != arguments["drawer"]:
                    raise Invalid("a handle of another thing")
                self.turn_joint(arguments["drawer"], 1.0 if skill == "open_drawer" else 0.0)
            case _:
                raise Invalid(f"no model of {skill}")

    def _need_open(self, place: str) -> None:
        if not self.holds(f"open({place})"):
            raise Invalid(f"{place} is not open")

    def _put(
        self, name: str, frame: Pose, middle: Vector, half: Vector, into: str, *, may_overhang: bool = False
    ) -> None:
        old = self.world.entities[name]
        sides = [compute_extent(old, axis) for axis in AXES]
        own = [(high - low) / 2 for low, high in sides]
        free = [max(h - o, 0.0) if may_overhang or h >= o else -1.0 for h, o in zip(half[:2], own[:2], strict=True)]
        if min(free) < 0.0:
            raise Invalid(f"{name} does not fit into {into}")
        others = [self.world.entities[each] for each in self.list_movable() if each != name]
        steps = [[0.0, *(s * i * STEP_M for i in range(1, int(f / STEP_M) + 1) for s in (1, -1))] for f in free]
        spots = sorted(itertools.product(*steps), key=(lambda spot: math.hypot(*spot)) if may_overhang else None)
        for dx, dy in spots:
            local = (middle[0] + dx, middle[1] + dy, middle[2] - (half[2] if not may_overhang else 0.0))
            x, y, z = to_parent(frame, local)
            placed = replace(old, pose=Pose((x, y, z - sides[2][0]), frame.quaternion_wxyz))
            if not any(_overlap(placed, other) for other in others):
                self.world = replace(self.world, entities=self.world.entities | {name: placed})
                return
        raise Invalid(f"no room for {name} in {into or 'that place'}")


def _overlap(one: Entity, other: Entity) -> bool:
    """Whether boxes about two objects, as wide as their diagonals allow, touch at the same height."""
    if one.name == other.name:
        return False
    for a, b in ((one, other), (other, one)):
        half = [(high - low) / 2 + GAP_M / 2 for low, high in (compute_extent(a, axis) for axis in AXES)]
        center = [(high + low) / 2 for low, high in (compute_extent(a, axis) for axis in AXES)]
        corners = itertools.product(*(compute_extent(b, axis) for axis in AXES))
        local = [to_child(a.pose, to_parent(b.pose, corner)) for corner in corners]
        spans = [(min(p[i] for p in local) - center[i], max(p[i] for p in local) - center[i]) for i in range(3)]
        level = GAP_M  # what lies on another one touches it
        if any(
            low >= h - (level if i == 2 else 0.0) or high <= -h + (level if i == 2 else 0.0)
            for i, ((low, high), h) in enumerate(zip(spans, half, strict=True))
        ):
            return False
    return True


def find_fault(wanted: WantedGoal, graph: GoalGraph, world: Environment, seed: int) -> str:
    """Why a goal graph does not reach a goal in some order that its edges allow; empty where it does in each.

    All orders are tried where there are few, else some drawn by the seed.
    """
    for order in _list_orders(graph, random.Random(seed)):
        kinematics = Kinematics(world)
        pending = list(wanted.steps)
        try:
            _advance(kinematics, pending)
            for name in order:
                choice = graph.choices[name]
                for text in graph.nodes[name].spec.requires:
                    if not kinematics.holds(text, choice.target):
                        raise Invalid(f"{text} is not true")
                kinematics.execute(choice.skill, choice.parameters)
                _advance(kinematics, pending)
                broken = [t for t in wanted.constraints if not kinematics.holds(t)]
                if broken:
                    raise Invalid(f"{broken[0]} is broken")
        except Invalid as error:
            return f"{' > '.join(order)}: {error}"
        unmet = [text for step in pending for text in step]
        unmet += [text for text in wanted.accept if not kinematics.holds(text)]
        if unmet:
            return f"{' > '.join(order)}: {'; '.join(unmet)} not true in the end"
    return ""


def _advance(kinematics: Kinematics, pending: list[tuple[str, ...]]) -> None:
    while pending and all(kinematics.holds(text) for text in pending[0]):
        pending.pop(0)
    for index, step in enumerate(pending[1:], 1):
        if index and all(kinematics.holds(text) for text in step) and step != pending[0]:
            kinematics_was = Kinematics(kinematics.initial)
            if not all(kinematics_was.holds(text) for text in step):
                raise Invalid(f"{'; '.join(step)} came true before {'; '.join(pending[0])}")


def _list_orders(graph: GoalGraph, chance: random.Random) -> list[list[str]]:
    orders = list(itertools.islice(nx.all_topological_sorts(graph.dag), ORDERS_MAX + 1))
    if len(orders) <= ORDERS_MAX:
        return orders
    drawn = []
    for _ in range(ORDERS_MAX):
        weights = {name: chance.random() for name in graph.dag}
        drawn.append(list(nx.lexicographical_topological_sort(graph.dag, key=weights.__getitem__)))
    return drawn
