"""Details that make a goal impossible, each in one node of a goal that is otherwise as any other."""

from collections.abc import Callable
from dataclasses import replace

from benchmarks.worlds.cases import Draft
from benchmarks.worlds.forms import make_box, make_vessel
from benchmarks.worlds.rooms import SceneObject, draw_color

FAR_M = ((0.70, 0.58), (0.80, 0.50), (0.72, 0.62))  # corners of the table out of reach


def draw_impossible(draft: Draft) -> str:
    """Make one node that cannot be met; its name, empty where this room has no place for it."""
    detail = draft.pick(list(IMPOSSIBLE))
    item, vessels = draft.choose(lambda t: t.on == "table" and t.yaw_rad is None), draft.room.vessels
    if item is None or not vessels:
        return ""
    vessel = vessels[int(draft.rng.integers(len(vessels)))]
    if not IMPOSSIBLE[detail](draft, item, vessel):
        return ""
    if not draft.nodes:
        draft.add(
            "pick_and_place",
            {"object": item.name, "destination": vessel.name},
            f"inside({item.name}, {vessel.name})",
        )
    return detail


def _grow(draft: Draft, item: SceneObject, least_m: float, most_m: float, mass_kg: float) -> bool:
    """Make it a box with half sides between these, where there is room for it."""
    x, y, z = draft.rng.uniform(least_m, most_m, 3)
    form = make_box(float(x), float(y), float(z))
    place = draft.floor.find(form.radius_m)
    if place is None:
        return False
    draft.room = draft.room.change(item.name, form=form, at_m=(*place, form.bottom_m + 0.001), mass_kg=mass_kg)
    return True


def _make_too_wide(draft: Draft, item: SceneObject, _vessel: SceneObject) -> bool:
    """Wider than the hand opens in every direction."""
    return _grow(draft, item, 0.088, 0.108, mass_kg=0.3)


def _make_slippery(draft: Draft, item: SceneObject, _vessel: SceneObject) -> bool:
    """Heavier than two fingers can hold by friction."""
    draft.room = draft.room.change(item.name, mass_kg=2.8, grip=(0.05, 0.08))
    return True


def _make_heavy(draft: Draft, item: SceneObject, _vessel: SceneObject) -> bool:
    """Heavier than the arm may carry."""
    draft.room = draft.room.change(item.name, mass_kg=round(float(draft.rng.uniform(4.0, 7.0)), 2), grip=(0.5, 0.6))
    return True


def _make_far(draft: Draft, item: SceneObject, _vessel: SceneObject) -> bool:
    """Out of reach, at a corner of the table."""
    x, y = FAR_M[int(draft.rng.integers(len(FAR_M)))]
    draft.room = draft.room.change(item.name, at_m=(x + 0.02, y + 0.02, item.at_m[2]))
    return True


def _make_small_vessel(draft: Draft, item: SceneObject, vessel: SceneObject) -> bool:
    """The object is larger than what it shall be put into."""
    if not _grow(draft, item, 0.060, 0.070, mass_kg=0.2):
        return False
    draft.room = draft.room.change(vessel.name, form=make_vessel(0.045, 0.050, 0.05, vessel.form.kind))
    return True


def _make_full(draft: Draft, item: SceneObject, vessel: SceneObject) -> bool:
    """The vessel is filled by a block that no hand can take out."""
    assert vessel.form.interior is not None
    (_, _, mid), (hx, hy, hz) = vessel.form.interior
    if min(hx, hy) < 0.046 or any(t.on == vessel.name for t in draft.room.movable):
        return False
    form = make_box(2 * hx - 0.004, 2 * hy - 0.004, 2 * hz - 0.002 if hz > 0.02 else 2 * hz + 0.02, "box")
    color, rgb = draw_color(draft.rng, [])
    at = (vessel.at_m[0], vessel.at_m[1], mid - hz + form.bottom_m + 0.001)
    block = SceneObject("filling", form, at, vessel.yaw_rad, color, rgb, mass_kg=1.0, on=vessel.name)
    draft.room = replace(draft.room, objects=draft.room.objects | {"filling": block})
    draft.used.add("filling")
    return True


def _make_on_ball(draft: Draft, item: SceneObject, _vessel: SceneObject) -> bool:
    """On top of a ball nothing stands."""
    balls = [t.name for t in draft.room.movable if t.form.kind == "ball" and t.name != item.name]
    if not balls or item.form.kind == "ball":
        return False
    ball = draft.pick(balls)
    draft.used.add(ball)
    draft.add("stack", {"object": item.name, "support": ball}, f"on({item.name}, {ball})")
    return True


def _make_twice(draft: Draft, item: SceneObject, vessel: SceneObject) -> bool:
    """In two places at once."""
    others = [v.name for v in draft.room.vessels if v.name != vessel.name]
    if not others:
        return False
    both = (f"inside({item.name}, {vessel.name})", f"inside({item.name}, {draft.pick(others)})")
    draft.add("pick_and_place", {"object": item.name, "destination": vessel.name}, *both)
    return True


IMPOSSIBLE: dict[str, Callable[[Draft, SceneObject, SceneObject], bool]] = {
    "too_wide": _make_too_wide,
    "slippery": _make_slippery,
    "heavy": _make_heavy,
    "far": _make_far,
    "small_vessel": _make_small_vessel,
    "full": _make_full,
    "on_ball": _make_on_ball,
    "twice": _make_twice,
}
