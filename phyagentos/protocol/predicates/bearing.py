"""What else may bear an object than what it is said to be on: beside it, between, around it."""

import math

from msgspec.structs import replace

from phyagentos.geometry import UP, to_parent
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.entity_geometry import (
    Top,
    compute_center,
    compute_centroid,
    compute_lowest,
    compute_reach,
    compute_sides,
    find_tops_below,
    is_around,
    measure_gaps,
    measure_radius,
)
from phyagentos.protocol.world.environment import Entity, Status

CONTACT_M = 0.002  # how far solids that touch may be apart, or in each other, beside the stated uncertainty


def find_between(view: View, a: Entity, b: str, top_m: float, most_m: float) -> Entity | None:
    """An object under the middle of a whose top is above that of b, and by no more than `most_m`.

    A container that a is inside of has a floor, however thin: what people put into it they took off the table.
    """
    center, highest_m = to_parent(a.pose, compute_centroid(a)), top_m + most_m
    of = view.now.entities.get(b)
    for other in view.now.entities.values():
        is_part = of is not None and (other.part_of == b or of.part_of == other.name)
        if other.name in {a.name, b} or is_part or other.held_by or not (other.movable or of is not None):
            continue
        tops, least_m = find_tops_below(other, center[0], center[1], 0.0), 0.0 if is_around(other, a) else CONTACT_M
        if other.status is not Status.GONE and any(top_m + least_m < top.point_m[2] <= highest_m for top in tops):
            return other
    return None


def find_covered(view: View, a: Entity, b: str, most_m: float) -> str | None:
    """An object that no look has surely shown, and that a may hide: no thicker than `most_m`, and no wider than a."""
    known = {} if view.now.prior is None else view.now.prior.sides_m
    sides = {name: known[name] for name in view.now.never_seen if name in known}
    sides |= {each.name: compute_sides(each) for each in view.now.entities.values() if each.movable and each.is_unsure}
    _, *own_m = compute_sides(a)
    for name, (least_m, *wide_m) in sides.items():
        is_hidden = all(side_m <= most + CONTACT_M for side_m, most in zip(wide_m, own_m, strict=True))
        if name not in {a.name, b} and least_m <= most_m and is_hidden:
            return name
    return None


def measure_gap(a: Entity, of: Entity | None, top: Top, sure_m: float, near_m: float) -> float:
    """How far the lowest point of a is above a top of another object [m], or the solid of a that touches it.

    A stand on a can hangs beside it: no solid of it is surely over the can, by `sure_m`, and deeper than `near_m`.
    """
    gap_m = top.measure_gap(a)
    if of is None or gap_m >= -near_m or min(measure_gaps(a, of, -sure_m)) < -near_m:
        return gap_m
    touching_m = min(measure_gaps(a, of, 0.0), key=abs)
    return touching_m if abs(touching_m) <= near_m else gap_m


def find_other_bearer(view: View, a: Entity, of: Entity, near_m: float) -> Entity | None:
    """An object on which other solids of a may stand than on `of`, as a stand does over a can."""
    gaps_m = zip(a.shapes, measure_gaps(a, of, 0.0), strict=True)
    free = replace(a, shapes=tuple(shape for shape, gap_m in gaps_m if abs(gap_m) > near_m))
    for other in view.now.entities.values() if free.shapes else ():
        is_part = other.part_of == of.name or of.part_of == other.name
        if other.name in {a.name, of.name} or is_part or other.held_by or other.status is Status.GONE:
            continue
        if any(abs(gap_m) <= near_m for gap_m in measure_gaps(free, other, 0.0)):
            return other
    return None


def find_prop(view: View, a: Entity, b: str, top_m: float) -> Entity | None:
    """An object near a that is higher than the top of b; b's own walls are of b."""
    of = view.now.entities.get(b)
    for other in view.now.entities.values():
        if other.name in {a.name, b} or other.held_by or other.status is Status.GONE:
            continue
        is_part = of is not None and (other.part_of == b or of.part_of == other.name)
        away_m = math.dist(other.pose.position_m[:2], a.pose.position_m[:2])
        is_high = other.pose.position_m[2] + compute_reach(other, UP) > top_m + CONTACT_M
        if is_high and not is_part and away_m < measure_radius(a) + measure_radius(other):
            return other
    return None


def measure_below(a: Entity, of: Entity | None) -> float:
    """How far the datum of a is below that of another object [m]; 0 where it is not, or one of them has none."""
    datums = [to_parent(each.pose, each.datum_m) for each in (a, of) if each is not None and each.datum_m is not None]
    return max(0.0, datums[1][2] - datums[0][2]) if len(datums) == 2 else 0.0


def measure_sunk(view: View, a: Entity, b: str) -> float:
    """How far the lowest point of a is below the rim of b, whose walls are around it [m]; 0 where more may bear it."""
    of, center, low_m = view.now.entities.get(b), compute_center(a), compute_lowest(a)
    if of is None:
        return 0.0
    solids = [replace(of, shapes=(shape,)) for shape in of.shapes]
    walls = [compute_center(each) for each in solids if each.pose.position_m[2] + compute_reach(each, UP) > low_m]
    if not all(any(sign * (wall[i] - center[i]) > 0.0 for wall in walls) for i in (0, 1) for sign in (1.0, -1.0)):
        return 0.0
    reach_m = max(compute_reach(of, way) for way in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    for other in view.now.entities.values():
        away_m = math.dist(other.pose.position_m[:2], of.pose.position_m[:2])
        if other.movable and other.name not in {a.name, b} and away_m < reach_m and compute_lowest(other) < low_m:
            return 0.0
    return of.pose.position_m[2] + compute_reach(of, UP) - low_m
