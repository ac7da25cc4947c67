"""Goals of one to four nodes over one room, with faults and impossible details, drawn from a seed.

A node that moves something is meant to be met; a *claim* is a node that only looks, and says what is or is not so: what
it says is true or false already when the robot begins.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from benchmarks.worlds.cases import Case, Draft, Node
from benchmarks.worlds.faults import draw_faults
from benchmarks.worlds.forms import SAME_FLIPPED, Rng
from benchmarks.worlds.impossible import draw_impossible
from benchmarks.worlds.rooms import USUAL, Room, Style, Thing, add_leaning, draw_room, list_twins

AGREED_SHARE = 0.5  # of goals in whose room equal things may stand for each other
FAULT_SHARE, IMPOSSIBLE_SHARE, LEANING_SHARE = 0.26, 0.16, 0.3
NODES_MAX = 4


def draw_case(seed: int, style: Style = USUAL) -> Case:
    """The goal of a seed; the same on every machine."""
    rng = np.random.default_rng([20_261_015, seed])
    mood = rng.random()
    for _ in range(50):
        room, floor = draw_room(seed, rng, style)
        draft = Draft(room, floor, rng)
        detail = draw_impossible(draft) if mood < IMPOSSIBLE_SHARE else ""
        wanted = int(rng.integers(1, NODES_MAX + 1))
        for _ in range(12):
            if len(draft.nodes) < wanted:
                NODES[str(rng.choice(list(NODES), p=list(style.weights)))](draft)
        if draft.nodes and (mood >= IMPOSSIBLE_SHARE or detail):
            break
    leaning = np.random.default_rng([20_261_015, seed, 1])
    if leaning.random() < LEANING_SHARE:
        _claim_leaning(draft, leaning, style)
    agrees = np.random.default_rng([20_261_015, seed, 3]).random() < AGREED_SHARE
    twins = list_twins(draft.room) if agrees else ()
    case = Case(seed, draft.room, tuple(_untangle(draft.nodes)), detail, interchangeable=twins)
    moved = [str(node.arguments["object"]) for node in case.nodes if not node.is_claim]
    if IMPOSSIBLE_SHARE <= mood < IMPOSSIBLE_SHARE + FAULT_SHARE and moved:
        case = replace(case, faults=tuple(draw_faults(rng, moved)))
    return replace(case, accept=_draw_acceptance(case), constraints=_draw_constraints(case, rng))


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
    stands = thing.form.stands and not any(thing.euler_rad)  # what begins tilted is not kept upright
    return (f"upright({thing.name})" if stands else f"not moved({thing.name})",)


# -- nodes -------------------------------------------------------------------------------------------------------------


def _put(draft: Draft) -> None:
    thing, vessels = draft.choose(), [v.name for v in draft.room.vessels]
    if thing is None or not vessels:
        return
    vessel = draft.pick(vessels)
    relation = "on" if draft.room.things[vessel].form.kind == "rimmed" else "inside"
    accept = [f"{relation}({thing.name}, {vessel})"]
    others = [t.name for t in draft.room.movable if t.name not in draft.used]
    if thing.form.stands and draft.rng.random() < 0.3:
        accept.append(f"upright({thing.name})")
    if others and draft.rng.random() < 0.25:
        accept.append(f"not moved({draft.pick(others)})")
    draft.add("pick_and_place", {"object": thing.name, "destination": vessel}, *accept)


def _put_on_spot(draft: Draft) -> None:
    if not draft.room.spots or (thing := draft.choose()) is None:
        return
    spot = next(iter(draft.room.spots))
    accept = draft.pick([f"inside({thing.name}, {spot})", f"at({thing.name}, {spot}, 0.03)"])
    draft.add("pick_and_place", {"object": thing.name, "destination": spot}, f"inside({thing.name}, {spot})", accept)


def _stack(draft: Draft) -> None:
    thing = draft.choose(lambda t: t.form.kind != "ball")
    if thing is None:
        return
    under = {each.on for each in draft.room.things.values()}
    tops = [
        t.name
        for t in draft.room.things.values()
        if t.form.top_m > 0.012 and t.name not in draft.used | under and not t.form.interior and not any(t.euler_rad)
    ]
    if not tops:
        draft.used.discard(thing.name)
        return
    support = draft.pick(tops)
    draft.used.add(support)
    draft.add("stack", {"object": thing.name, "support": support}, f"on({thing.name}, {support})")


def _hold(draft: Draft) -> None:
    if draft.nodes or (thing := draft.choose()) is None:
        return
    more = draft.pick([f"height({thing.name}) >= 0.04", "count(holding(target, *)) == 1"])
    draft.add("pick", {"object": thing.name}, f"holding(target, {thing.name})", more)


def _find_spot(draft: Draft, is_fit: Callable[[Thing], bool]) -> tuple[Thing, list[float]] | None:
    """An object on the table, and a free place there for it [m]."""
    thing = draft.choose(lambda t: t.on == "table" and is_fit(t))
    place = draft.floor.find(0.07, (0.40, 0.60)) if thing else None
    if thing is None or place is None:
        return None
    return thing, [round(place[0], 3), round(place[1], 3), round(thing.at_m[2], 3)]


def _push(draft: Draft) -> None:
    if (found := _find_spot(draft, lambda t: t.form.span_m[2] < 0.085)) is not None:
        thing, to = found
        draft.add("push", {"object": thing.name, "to": to}, f"at({thing.name}, ({to[0]}, {to[1]}, {to[2]}), 0.05)")


def _set_aside(draft: Draft) -> None:
    if (found := _find_spot(draft, lambda _: True)) is not None:
        thing, to = found
        at = f"at({thing.name}, ({to[0]}, {to[1]}, {to[2]}), 0.12)"
        draft.add("set_aside", {"object": thing.name, "support": "table", "to": to}, at, f"on({thing.name}, table)")


def _claim(draft: Draft) -> None:
    under = {each.on for each in draft.room.movable}
    things = [t for t in draft.room.movable if t.name not in draft.used | under]
    if not things:
        return
    thing = things[int(draft.rng.integers(len(things)))]
    draft.used.add(thing.name)
    said = list(iter_claims(draft.room, thing, draft.rng))
    number = int(draft.rng.integers(1, 3))
    accept = [said[index] for index in draft.rng.choice(len(said), size=number, replace=False)]
    draft.add("inspect", {"object": thing.name}, *accept, is_claim=True)


def _claim_leaning(draft: Draft, rng: Rng, style: Style) -> None:
    """A thing that leans, and what is said of how it stands: near the limits of `upright` and of a tilt."""
    if len(draft.nodes) == NODES_MAX:
        return
    draft.room, name = add_leaning(draft.room, draft.floor, rng, style)
    if name:
        said = [f"upright({name})", f"not upright({name})", f"tilt({name}) <= 0.12", f"on({name}, table)"]
        draft.add("inspect", {"object": name}, str(rng.choice(said)), is_claim=True)


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
    if thing.form.kind not in SAME_FLIPPED:
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


NODES: dict[str, Callable[[Draft], None]] = {
    "put": _put,
    "spot": _put_on_spot,
    "stack": _stack,
    "hold": _hold,
    "push": _push,
    "aside": _set_aside,
    "claim": _claim,
}
