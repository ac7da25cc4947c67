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
from benchmarks.worlds.rooms import USUAL, Room, SceneObject, Style, add_leaning, draw_room, list_twins

AGREED_SHARE = 0.5  # of goals in whose room equal objects may stand for each other
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
    others = [item for item in case.room.movable if item.name not in taken]
    if not others or rng.random() > 0.2:
        return ()
    item = others[int(rng.integers(len(others)))]
    stands = item.form.stands and not any(item.euler_rad)  # what begins tilted is not kept upright
    return (f"upright({item.name})" if stands else f"not moved({item.name})",)


# -- nodes -------------------------------------------------------------------------------------------------------------


def _put(draft: Draft) -> None:
    item, vessels = draft.choose(), [v.name for v in draft.room.vessels]
    if item is None or not vessels:
        return
    vessel = draft.pick(vessels)
    relation = "on" if draft.room.objects[vessel].form.kind == "rimmed" else "inside"
    accept = [f"{relation}({item.name}, {vessel})"]
    others = [t.name for t in draft.room.movable if t.name not in draft.used]
    if item.form.stands and draft.rng.random() < 0.3:
        accept.append(f"upright({item.name})")
    if others and draft.rng.random() < 0.25:
        accept.append(f"not moved({draft.pick(others)})")
    draft.add("pick_and_place", {"object": item.name, "destination": vessel}, *accept)


def _put_on_spot(draft: Draft) -> None:
    if not draft.room.spots or (item := draft.choose()) is None:
        return
    spot = next(iter(draft.room.spots))
    accept = draft.pick([f"inside({item.name}, {spot})", f"at({item.name}, {spot}, 0.03)"])
    draft.add("pick_and_place", {"object": item.name, "destination": spot}, f"inside({item.name}, {spot})", accept)


def _stack(draft: Draft) -> None:
    item = draft.choose(lambda t: t.form.kind != "ball")
    if item is None:
        return
    under = {each.on for each in draft.room.objects.values()}
    tops = [
        t.name
        for t in draft.room.objects.values()
        if t.form.top_m > 0.012 and t.name not in draft.used | under and not t.form.interior and not any(t.euler_rad)
    ]
    if not tops:
        draft.used.discard(item.name)
        return
    support = draft.pick(tops)
    draft.used.add(support)
    draft.add("stack", {"object": item.name, "support": support}, f"on({item.name}, {support})")


def _hold(draft: Draft) -> None:
    if draft.nodes or (item := draft.choose()) is None:
        return
    more = draft.pick([f"height({item.name}) >= 0.04", "count(holding(target, *)) == 1"])
    draft.add("pick", {"object": item.name}, f"holding(target, {item.name})", more)


def _find_spot(draft: Draft, is_fit: Callable[[SceneObject], bool]) -> tuple[SceneObject, list[float]] | None:
    """An object on the table, and a free place there for it [m]."""
    item = draft.choose(lambda t: t.on == "table" and is_fit(t))
    place = draft.floor.find(0.07, (0.40, 0.60)) if item else None
    if item is None or place is None:
        return None
    return item, [round(place[0], 3), round(place[1], 3), round(item.at_m[2], 3)]


def _push(draft: Draft) -> None:
    if (found := _find_spot(draft, lambda t: t.form.span_m[2] < 0.085)) is not None:
        item, to = found
        draft.add("push", {"object": item.name, "to": to}, f"at({item.name}, ({to[0]}, {to[1]}, {to[2]}), 0.05)")


def _set_aside(draft: Draft) -> None:
    if (found := _find_spot(draft, lambda _: True)) is not None:
        item, to = found
        at = f"at({item.name}, ({to[0]}, {to[1]}, {to[2]}), 0.12)"
        draft.add("set_aside", {"object": item.name, "support": "table", "to": to}, at, f"on({item.name}, table)")


def _claim(draft: Draft) -> None:
    under = {each.on for each in draft.room.movable}
    objects = [t for t in draft.room.movable if t.name not in draft.used | under]
    if not objects:
        return
    item = objects[int(draft.rng.integers(len(objects)))]
    draft.used.add(item.name)
    said = list(iter_claims(draft.room, item, draft.rng))
    number = int(draft.rng.integers(1, 3))
    accept = [said[index] for index in draft.rng.choice(len(said), size=number, replace=False)]
    draft.add("inspect", {"object": item.name}, *accept, is_claim=True)


def _claim_leaning(draft: Draft, rng: Rng, style: Style) -> None:
    """An object that leans, and what is said of how it stands: near the limits of `upright` and of a tilt."""
    if len(draft.nodes) == NODES_MAX:
        return
    draft.room, name = add_leaning(draft.room, draft.floor, rng, style)
    if name:
        said = [f"upright({name})", f"not upright({name})", f"tilt({name}) <= 0.12", f"on({name}, table)"]
        draft.add("inspect", {"object": name}, str(rng.choice(said)), is_claim=True)


def iter_claims(room: Room, item: SceneObject, rng: Rng) -> Iterator[str]:
    """What may be said of an object that nothing moves; about half of it is false."""
    x, y, z = item.at_m
    others = [t for t in room.objects.values() if t.name != item.name]
    other = others[int(rng.integers(len(others)))].name if others else "table"
    supports = ["table", *(t.name for t in others if t.fixed or t.form.top_m > 0.012)]
    support = supports[int(rng.integers(len(supports)))]
    shift = float(rng.choice([0.0, 0.08]))
    yield f"at({item.name}, ({x + shift:.3f}, {y:.3f}, {z:.3f}), 0.03)"
    yield f"on({item.name}, {item.on})"
    yield f"on({item.name}, {support})"
    yield f"on({item.name}, {support}) or on({item.name}, {other})"
    yield f"near({item.name}, {other}, {rng.uniform(0.06, 0.3):.2f})"
    yield f"distance({item.name}, {other}) >= {rng.uniform(0.06, 0.4):.2f}"
    yield f"height({item.name}) {rng.choice(['<=', '>='])} {rng.uniform(0.005, 0.08):.3f}"
    yield f"moved({item.name})"
    yield f"not moved({item.name})"
    yield f"exists({item.name}) and visible({item.name})"
    yield "not moved(*)"
    yield f"not holding(target, {item.name})"
    yield f"speed({item.name}) <= 0.02"
    for vessel in room.vessels:
        yield f"inside({item.name}, {vessel.name})"
        yield f"not inside(*, {vessel.name})"
        yield f"count(inside(*, {vessel.name})) {rng.choice(['>=', '==', '<='])} {int(rng.integers(0, 3))}"
    if item.form.kind not in SAME_FLIPPED:
        yield f"upright({item.name})"
        yield f"not upright({item.name})"
        yield f"fallen({item.name})"
        yield f"tilt({item.name}) {rng.choice(['<=', '>='])} {rng.choice([0.12, 0.3])}"


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
