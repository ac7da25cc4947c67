"""Goals of one to four nodes over one room, with faults and impossible details, drawn from a seed.

A node that moves something is meant to be met; a *claim* is a node that only looks, and says what is or is not so: what
it says is true or false already when the robot begins.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.unseen_parts.forms import Rng, make_box, make_vessel
from benchmarks.unseen_parts.rooms import Floor, Room, Thing, draw_color, draw_room

FAULT_SHARE, IMPOSSIBLE_SHARE = 0.26, 0.16
CAMERAS = ("overhead", "left", "right", "wrist")
FAR_M = ((0.70, 0.58), (0.80, 0.50), (0.72, 0.62))  # corners of the table out of reach


@dataclass(frozen=True, slots=True)
class Node:
    """One session as it is asked for.

    Attributes:
        arguments: Of the skill.
        accept: Predicates, in the language of goal graphs.
        is_claim: Whether it only looks.
        after: Names of nodes before it.
    """

    name: str
    skill: str
    arguments: dict[str, object]
    accept: tuple[str, ...]
    is_claim: bool = False
    after: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Case:
    """One goal in one room.

    Attributes:
        detail: Name of the impossible detail; empty where there is none.
        faults: As in a fault file, without the pattern of the session.
        constraints: Sampled all through.
        accept: The goal's own acceptance.
    """

    seed: int
    room: Room
    nodes: tuple[Node, ...]
    detail: str = ""
    faults: tuple[dict[str, object], ...] = ()
    constraints: tuple[str, ...] = ()
    accept: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Of the goal."""
        return f"unseen_{self.seed}"


@dataclass(slots=True)
class _Draft:
    room: Room
    floor: Floor
    rng: Rng
    nodes: list[Node] = field(default_factory=list)
    used: set[str] = field(default_factory=set)

    def choose(self, fits: Callable[[Thing], bool] = lambda _: True) -> Thing | None:
        """A movable thing that no node takes up yet, and on which nothing stands."""
        under = {thing.on for thing in self.room.movable}
        free = [t for t in self.room.movable if t.name not in self.used | under and fits(t)]
        if not free:
            return None
        found = free[int(self.rng.integers(len(free)))]
        self.used.add(found.name)
        return found

    def pick(self, names: list[str]) -> str:
        """One of these names."""
        return names[int(self.rng.integers(len(names)))]

    def add(self, skill: str, arguments: dict[str, object], *accept: str, is_claim: bool = False) -> None:
        """One more node."""
        after = (self.nodes[-1].name,) if self.nodes and self.rng.random() < 0.3 else ()
        self.nodes.append(Node(f"n{len(self.nodes) + 1}", skill, arguments, accept, is_claim, after))


def draw_case(seed: int, *, friction: tuple[float, float] = (0.2, 0.6)) -> Case:
    """The goal of a seed; the same on every machine."""
    rng = np.random.default_rng([20_261_015, seed])
    mood = rng.random()
    for _ in range(50):
        room, floor = draw_room(seed, rng, friction=friction)
        draft = _Draft(room, floor, rng)
        detail = _draw_impossible(draft) if mood < IMPOSSIBLE_SHARE else ""
        wanted = int(rng.integers(1, 5))
        for _ in range(12):
            if len(draft.nodes) < wanted:
                NODES[str(rng.choice(list(NODES), p=list(WEIGHTS)))](draft)
        if draft.nodes and (mood >= IMPOSSIBLE_SHARE or detail):
            break
    case = Case(seed, draft.room, tuple(_untangle(draft.nodes)), detail)
    moved = [str(node.arguments["object"]) for node in case.nodes if not node.is_claim]
    if IMPOSSIBLE_SHARE <= mood < IMPOSSIBLE_SHARE + FAULT_SHARE and moved:
        case = replace(case, faults=tuple(_draw_faults(rng, moved)))
    return replace(case, accept=_draw_acceptance(case), constraints=_draw_constraints(case, rng))


# -- nodes -------------------------------------------------------------------------------------------------------------


def _put(draft: _Draft) -> None:
    thing, vessels = draft.choose(), [v.name for v in draft.room.vessels]
    if thing is None or not vessels:
        return
    vessel = draft.pick(vessels)
    accept = [f"inside({thing.name}, {vessel})"]
    others = [t.name for t in draft.room.movable if t.name not in draft.used]
    if thing.form.stands and draft.rng.random() < 0.3:
        accept.append(f"upright({thing.name})")
    if others and draft.rng.random() < 0.25:
        accept.append(f"not moved({draft.pick(others)})")
    draft.add("pick_and_place", {"object": thing.name, "destination": vessel}, *accept)


def _put_on_spot(draft: _Draft) -> None:
    if not draft.room.spots or (thing := draft.choose()) is None:
        return
    spot = next(iter(draft.room.spots))
    accept = draft.pick([f"inside({thing.name}, {spot})", f"at({thing.name}, {spot}, 0.03)"])
    draft.add("pick_and_place", {"object": thing.name, "destination": spot}, f"inside({thing.name}, {spot})", accept)


def _stack(draft: _Draft) -> None:
    thing = draft.choose(lambda t: t.form.kind != "ball")
    if thing is None:
        return
    under = {each.on for each in draft.room.movable}
    tops = [
        t.name
        for t in draft.room.things.values()
        if t.form.top_m > 0.012 and t.name not in draft.used | under and not t.form.interior
    ]
    if not tops:
        draft.used.discard(thing.name)
        return
    support = draft.pick(tops)
    draft.used.add(support)
    draft.add("stack", {"object": thing.name, "support": support}, f"on({thing.name}, {support})")


def _hold(draft: _Draft) -> None:
    if draft.nodes or (thing := draft.choose()) is None:
        return
    more = draft.pick([f"height({thing.name}) >= 0.04", "count(holding(target, *)) == 1"])
    draft.add("pick", {"object": thing.name}, f"holding(target, {thing.name})", more)


def _push(draft: _Draft) -> None:
    thing = draft.choose(lambda t: t.on == "table" and t.form.span_m[2] < 0.085)
    place = draft.floor.find(0.07, (0.40, 0.60)) if thing else None
    if thing is None or place is None:
        return
    to = [round(place[0], 3), round(place[1], 3), round(thing.at_m[2], 3)]
    at = f"at({thing.name}, ({to[0]}, {to[1]}, {to[2]}), 0.05)"
    draft.add("push", {"object": thing.name, "to": to}, at)


def _set_aside(draft: _Draft) -> None:
    thing = draft.choose(lambda t: t.on == "table")
    place = draft.floor.find(0.07, (0.40, 0.60)) if thing else None
    if thing is None or place is None:
        return
    to = [round(place[0], 3), round(place[1], 3), round(thing.at_m[2], 3)]
    at = f"at({thing.name}, ({to[0]}, {to[1]}, {to[2]}), 0.12)"
    draft.add("set_aside", {"object": thing.name, "support": "table", "to": to}, at, f"on({thing.name}, table)")


def _claim(draft: _Draft) -> None:
    things = [t for t in draft.room.movable if t.name not in draft.used]
    if not things:
        return
    thing = things[int(draft.rng.integers(len(things)))]
    draft.used.add(thing.name)
    said = list(iter_claims(draft.room, thing, draft.rng))
    number = int(draft.rng.integers(1, 3))
    accept = [said[index] for index in draft.rng.choice(len(said), size=number, replace=False)]
    draft.add("inspect", {"object": thing.name}, *accept, is_claim=True)


def iter_claims(room: Room, thing: Thing, rng: Rng) -> Iterator[str]:
    """What may be said of a thing that nothing moves; about half of it is false."""
    x, y, z = thing.at_m
    others = [t for t in room.things.values() if t.name != thing.name]
    other = others[int(rng.integers(len(others)))].name if others else "table"
    supports = ["table", *(t.name for t in others if t.fixed or t.form.top_m > 0.012)]
    support = supports[int(rng.integers(len(supports)))]
    shift = float(rng.choice([0.0, 0.08]))
    yield f"at({thing.name}, ({x + shift:.3f}, {y:.3f}, {z:.3f}), 0.03)"
    yield f"on({thing.name}, {thing.on})"
    yield f"on({thing.name}, {support})"
    yield f"on({thing.name}, {support}) or on({thing.name}, {other})"
    yield f"near({thing.name}, {other}, {rng.uniform(0.06, 0.3):.2f})"
    yield f"distance({thing.name}, {other}) >= {rng.uniform(0.06, 0.4):.2f}"
    yield f"height({thing.name}) {rng.choice(['<=', '>='])} {rng.uniform(0.005, 0.08):.3f}"
    yield f"moved({thing.name})"
    yield f"not moved({thing.name})"
    yield f"exists({thing.name}) and visible({thing.name})"
    yield "not moved(*)"
    yield f"not holding(target, {thing.name})"
    yield f"speed({thing.name}) <= 0.02"
    for vessel in room.vessels:
        yield f"inside({thing.name}, {vessel.name})"
        yield f"not inside(*, {vessel.name})"
        yield f"count(inside(*, {vessel.name})) {rng.choice(['>=', '==', '<='])} {int(rng.integers(0, 3))}"
    if thing.form.kind != "ball":
        yield f"upright({thing.name})"
        yield f"not upright({thing.name})"
        yield f"fallen({thing.name})"
        yield f"tilt({thing.name}) {rng.choice(['<=', '>='])} {rng.choice([0.12, 0.3])}"


def _untangle(nodes: list[Node]) -> Iterator[Node]:
    """Claims say nothing about what another node changes."""
    changed = {str(value) for node in nodes if not node.is_claim for value in node.arguments.values()}
    for node in nodes:
        told = tuple(text for text in node.accept if not changed & set(re.findall(r"\w+", text)) - {"table"})
        kept = told or (f"exists({node.arguments['object']}) and visible({node.arguments['object']})",)
        yield replace(node, accept=kept) if node.is_claim else node


NODES: dict[str, Callable[[_Draft], None]] = {
    "put": _put,
    "spot": _put_on_spot,
    "stack": _stack,
    "hold": _hold,
    "push": _push,
    "aside": _set_aside,
    "claim": _claim,
}
WEIGHTS = (0.38, 0.07, 0.14, 0.05, 0.05, 0.05, 0.26)


# -- impossible details ------------------------------------------------------------------------------------------------


def _draw_impossible(draft: _Draft) -> str:
    """Make one node that cannot be met; its name, empty where this room has no place for it."""
    detail = draft.pick(list(IMPOSSIBLE))
    thing, vessels = draft.choose(lambda t: t.on == "table" and t.yaw_rad is None), draft.room.vessels
    if thing is None or not vessels:
        return ""
    vessel = vessels[int(draft.rng.integers(len(vessels)))]
    if not IMPOSSIBLE[detail](draft, thing, vessel):
        return ""
    if not draft.nodes:
        draft.add(
            "pick_and_place",
            {"object": thing.name, "destination": vessel.name},
            f"inside({thing.name}, {vessel.name})",
        )
    return detail


def _make_too_wide(draft: _Draft, thing: Thing, vessel: Thing) -> bool:
    """Wider than the hand opens in every direction."""
    del vessel
    form = make_box(*(float(draft.rng.uniform(0.088, 0.108)) for _ in range(3)))
    place = draft.floor.find(form.radius_m)
    if place is None:
        return False
    draft.room = draft.room.change(thing.name, form=form, at_m=(*place, form.bottom_m + 0.001), mass_kg=0.3)
    return True


def _make_slippery(draft: _Draft, thing: Thing, vessel: Thing) -> bool:
    """Heavier than two fingers can hold by friction."""
    del vessel
    draft.room = draft.room.change(thing.name, mass_kg=2.8, grip=(0.05, 0.08))
    return True


def _make_heavy(draft: _Draft, thing: Thing, vessel: Thing) -> bool:
    """Heavier than the arm may carry."""
    del vessel
    draft.room = draft.room.change(thing.name, mass_kg=round(float(draft.rng.uniform(4.0, 7.0)), 2), grip=(0.5, 0.6))
    return True


def _make_far(draft: _Draft, thing: Thing, vessel: Thing) -> bool:
    """Out of reach, at a corner of the table."""
    del vessel
    x, y = FAR_M[int(draft.rng.integers(len(FAR_M)))]
    draft.room = draft.room.change(thing.name, at_m=(x + 0.02, y + 0.02, thing.at_m[2]))
    return True


def _make_small_vessel(draft: _Draft, thing: Thing, vessel: Thing) -> bool:
    """The thing is larger than what it shall be put into."""
    form = make_box(*(float(draft.rng.uniform(0.060, 0.070)) for _ in range(3)))
    place = draft.floor.find(form.radius_m)
    if place is None:
        return False
    draft.room = draft.room.change(thing.name, form=form, at_m=(*place, form.bottom_m + 0.001), mass_kg=0.2)
    draft.room = draft.room.change(vessel.name, form=make_vessel(0.045, 0.050, 0.05, vessel.form.kind))
    return True


def _make_full(draft: _Draft, thing: Thing, vessel: Thing) -> bool:
    """The vessel is filled by a block that no hand can take out."""
    assert vessel.form.interior is not None
    (_, _, mid), (hx, hy, hz) = vessel.form.interior
    if min(hx, hy) < 0.046 or any(t.on == vessel.name for t in draft.room.movable):
        return False
    form = make_box(2 * hx - 0.004, 2 * hy - 0.004, 2 * hz - 0.002 if hz > 0.02 else 2 * hz + 0.02, "box")
    color, rgb = draw_color(draft.rng, [])
    at = (vessel.at_m[0], vessel.at_m[1], mid - hz + form.bottom_m + 0.001)
    block = Thing("filling", form, at, vessel.yaw_rad, color, rgb, mass_kg=1.0, on=vessel.name)
    draft.room = replace(draft.room, things=draft.room.things | {"filling": block})
    draft.used.add("filling")
    return True


def _make_on_ball(draft: _Draft, thing: Thing, vessel: Thing) -> bool:
    """On top of a ball nothing stands."""
    del vessel
    balls = [t.name for t in draft.room.movable if t.form.kind == "ball" and t.name != thing.name]
    if not balls or thing.form.kind == "ball":
        return False
    ball = draft.pick(balls)
    draft.used.add(ball)
    draft.add("stack", {"object": thing.name, "support": ball}, f"on({thing.name}, {ball})")
    return True


def _make_twice(draft: _Draft, thing: Thing, vessel: Thing) -> bool:
    """In two places at once."""
    others = [v.name for v in draft.room.vessels if v.name != vessel.name]
    if not others:
        return False
    both = (f"inside({thing.name}, {vessel.name})", f"inside({thing.name}, {draft.pick(others)})")
    draft.add("pick_and_place", {"object": thing.name, "destination": vessel.name}, *both)
    return True


IMPOSSIBLE: dict[str, Callable[[_Draft, Thing, Thing], bool]] = {
    "too_wide": _make_too_wide,
    "slippery": _make_slippery,
    "heavy": _make_heavy,
    "far": _make_far,
    "small_vessel": _make_small_vessel,
    "full": _make_full,
    "on_ball": _make_on_ball,
    "twice": _make_twice,
}


# -- faults and acceptance ---------------------------------------------------------------------------------------------


def _draw_faults(rng: Rng, moved: list[str]) -> Iterator[dict[str, object]]:
    """One fault of a thing, a motor or a camera; with sensors more may lie at once."""
    thing = moved[int(rng.integers(len(moved)))]
    kinds = ["slip", "nudge", "move", "remove", "stall", "freeze", "blackout", "misdate", "miscalibrate"]
    kind = str(rng.choice(kinds))
    near = {"gripper_near_m": round(float(rng.uniform(0.04, 0.25)), 3)}
    if kind == "slip":
        yield {"kind": kind, "object": thing, "when": {"lifted_m": round(float(rng.uniform(0.05, 0.12)), 3)}}
    elif kind in {"nudge", "move", "remove"}:
        yield {"kind": kind, "object": thing, "when": near}
    elif kind == "stall":
        yield {"kind": kind, "joint": f"joint{int(rng.integers(1, 7))}", "object": thing, "when": near}
    else:
        cameras = list(rng.choice([*CAMERAS, "*"], size=int(rng.integers(1, 3)), replace=False))
        for camera in cameras:
            yield _draw_lie(kind, str(camera), rng)


def _draw_lie(kind: str, camera: str, rng: Rng) -> dict[str, object]:
    begins = {"time_s": round(float(rng.uniform(0.5, 8.0)), 2)}
    one: dict[str, object] = {"kind": kind, "camera": camera, "when": begins}
    if kind == "freeze":
        one["stamp"] = str(rng.choice(["fresh", "stale"]))
    elif kind == "blackout":
        one["mode"] = str(rng.choice(["dark", "silent"]))
    elif kind == "misdate":
        one["by_s"] = round(float(rng.choice([-1, 1]) * rng.uniform(0.3, 6.0)), 2)
    else:
        one["by_m"] = [round(float(value), 4) for value in rng.uniform(-0.04, 0.04, 3)]
        one["by_rad"] = [round(float(value), 4) for value in rng.uniform(-0.03, 0.03, 3)]
        one["when"] = {}
    return one


def _draw_acceptance(case: Case) -> tuple[str, ...]:
    """Everything lasting that the nodes bring about."""
    passing = ("holding(", "moved(", "visible(", "speed(", "tilt(", "height(", "distance(")
    lasting = [text for node in case.nodes for text in node.accept if not any(word in text for word in passing)]
    return tuple(dict.fromkeys(lasting))


def _draw_constraints(case: Case, rng: Rng) -> tuple[str, ...]:
    """Now and then something that must hold all through."""
    taken = {value for node in case.nodes for value in node.arguments.values() if isinstance(value, str)}
    others = [thing for thing in case.room.movable if thing.name not in taken]
    if not others or rng.random() > 0.2:
        return ()
    thing = others[int(rng.integers(len(others)))]
    return (f"upright({thing.name})" if thing.form.stands else f"not moved({thing.name})",)
