"""Where objects are from where one looks, and which of them is leftmost, nearest or largest.

Left, right, front and back depend on who looks: the robot at its mount, or a person who faces it. Where the two differ,
the understander puts a question.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from phyagentos.agent.understanding.vocabulary import SURFACES, SceneObject
from phyagentos.geometry import Vector

VIEWS = {"as seen by the robot": 1.0, "as seen by a person who faces the robot": -1.0}
SIDES: Mapping[str, tuple[float, float]] = {
    "left": (0.0, 1.0),
    "right": (0.0, -1.0),
    "back": (1.0, 0.0),
    "front": (-1.0, 0.0),
}  # direction in the world for the robot, which looks along x
_ALONG = {"toward": -1.0, "away": 1.0}  # the line from the robot, or from another object, to an object
_REACH_M = (0.3, 0.7)  # from the mount, as shipped arms have it; plans find out what one can reach
GAP_M = 0.04  # between two objects that are put side by side
BESIDE_M = 0.15  # between the middles of objects that are next to each other
NEARLY_M = 0.24  # of those that a person may call so, too
_ORDERS_MAX = 6  # to choose from
_TALL = 1.2  # height to width
_APART_M, _ALIKE = 0.01, 0.05  # places, and shares of a size, that are taken for equal
_SIZES: Mapping[str, Callable[[SceneObject], float]] = {
    "large": lambda body: math.prod(body.half_m),
    "small": lambda body: -math.prod(body.half_m),
    "tall": lambda body: body.half_m[2],
    "long": lambda body: max(body.half_m[:2]),
    "top": lambda body: body.at_m[2] if body.at_m else 0.0,
    "bottom": lambda body: -body.at_m[2] if body.at_m else 0.0,
}


def list_most(bodies: Sequence[SceneObject], kind: str, view: float, reference: Vector | None) -> list[str]:
    """Those that are most so, several where they are equally so; all where places are not known.

    `reference` is that from which `near` and `far` are measured: by default the robot, at the origin.
    """
    if not bodies or any(body.at_m is None for body in bodies):
        return [body.name for body in bodies]
    if kind == "middle":
        return _list_middle(bodies)
    if kind in _SIZES:
        sizes = {body.name: _SIZES[kind](body) for body in bodies}
        most = max(sizes.values())
        return [name for name, size in sizes.items() if most - size <= _ALIKE * abs(most)]
    ranks = {body.name: _rank(body, kind, view, reference) for body in bodies}
    return [name for name, rank in ranks.items() if max(ranks.values()) - rank <= _APART_M]


def _list_middle(bodies: Sequence[SceneObject]) -> list[str]:
    """The middle one of an odd number that stand along a line; all where there is none."""
    columns = [[body.at_m[axis] for body in bodies if body.at_m is not None] for axis in (0, 1)]
    axis = max((0, 1), key=lambda each: max(columns[each]) - min(columns[each]))
    ordered = sorted(bodies, key=lambda body: columns[axis][bodies.index(body)])
    middle = ordered[len(bodies) // 2]
    is_one = len(bodies) % 2 == 1 and (len(bodies) == 1 or is_between(middle, (ordered[0], ordered[-1])))
    return [each.name for each in ([middle] if is_one else bodies)]


def list_nth(
    bodies: Sequence[SceneObject], kind: str, view: float, nth: int, reference: Vector | None = None
) -> list[str]:
    """Those that are most so once those before the `nth` are left aside; all where some are equally so."""
    most = list_most(bodies, kind, view, reference)
    if nth == 1 or len(most) != 1:
        return most if nth == 1 else [body.name for body in bodies]
    return list_nth([body for body in bodies if body.name not in most], kind, view, nth - 1, reference)


def list_first(
    bodies: Sequence[SceneObject], kind: str, view: float, count: int, reference: Vector | None
) -> list[str]:
    """Those that are most so, as many as are counted; more where some are equally so."""
    names: list[str] = []
    while len(names) < min(count, len(bodies)):
        names += list_most([body for body in bodies if body.name not in names], kind, view, reference)
    return names


def list_by_size(bodies: Sequence[SceneObject]) -> list[list[str]]:
    """Names from the largest to the smallest; one order for each of those that are alike, none of more than a few."""
    orders: list[list[str]] = [[]]
    for _ in bodies:
        rest = [[body for body in bodies if body.name not in order] for order in orders]
        orders = [
            [*order, name]
            for order, left in zip(orders, rest, strict=True)
            for name in list_most(left, "large", 1.0, None)
        ]
    return orders if len(orders) <= _ORDERS_MAX else []


def list_beside(
    bodies: Sequence[SceneObject], kind: str, view: float, owner: SceneObject, most_m: float = BESIDE_M
) -> list[str]:
    """Those on a side of an object, or `beside` it, so far at most; all where places are not known."""
    others = [body for body in bodies if body.name != owner.name]
    if owner.at_m is None or any(body.at_m is None for body in others):
        return [body.name for body in others]
    if kind == "beside":  # what an object is in, or has in it, is not beside it
        others = [each for each in others if each.name != owner.stands and each.stands != owner.name]
        return [each.name for each in others if each.at_m and math.dist(each.at_m[:2], owner.at_m[:2]) <= most_m]
    if kind == "under":
        return [each.name for each in others if _is_under(each, owner)]
    border = _rank(owner, kind, view, None)
    return [body.name for body in others if _rank(body, kind, view, None) - border > _APART_M]


def place_beside(body: SceneObject, side: str, view: float, owner: SceneObject) -> Vector | None:
    """A point on a side of an object where another one can stand [m]; None where places are not known."""
    if body.at_m is None or owner.at_m is None:
        return None
    apart_m = math.hypot(*owner.half_m[:2]) + math.hypot(*body.half_m[:2]) + GAP_M
    bottom_m = min(each.at_m[2] - each.half_m[2] for each in (body, owner) if each.at_m is not None)
    z_m = bottom_m + body.half_m[2] if body.stands else body.at_m[2]
    return shift((owner.at_m[0], owner.at_m[1], z_m), side, view, apart_m)


def find_beside(body: SceneObject, owner: SceneObject, others: Sequence[SceneObject]) -> Vector | None:
    """The point beside an object, on any side of it, that is farthest from all others [m]; None without places."""
    points = [point for side in SIDES if (point := place_beside(body, side, 1.0, owner)) is not None]
    around = [each.at_m for each in others if each.at_m is not None and each.movable]
    return max(
        points, key=lambda point: min((math.dist(point[:2], at[:2]) for at in around), default=0.0), default=None
    )


def find_row(
    bodies: Sequence[SceneObject],
    others: Sequence[SceneObject],
    sides: Iterable[str] = SIDES,
    view: float = 1.0,
    stays: Iterable[int] = (0,),
) -> list[Vector] | None:
    """Points of a row through where the first object, or another one, stands [m]; None where there is no room."""
    if any(body.at_m is None or body.stands for body in bodies):
        return None
    apart_m = 2 * max(math.hypot(*body.half_m[:2]) for body in bodies) + GAP_M
    rows = [
        [shift((*at_m[:2], (body.at_m or at_m)[2]), side, view, (n - stay) * apart_m) for n, body in enumerate(bodies)]
        for stay in stays
        for side in sides
        if (at_m := bodies[stay].at_m)
    ]
    rooms = {
        n: min((_room(point, each) for point in row for each in others), default=1.0) for n, row in enumerate(rows)
    }
    free = [row for n, row in enumerate(rows) if rooms[n] > apart_m / 2 and _is_near(row)]
    return max(free, key=lambda row: rooms[rows.index(row)], default=None)


def _room(point_m: Vector, body: SceneObject) -> float:
    """How far a point is from the box around an object, seen from above [m]."""
    at_m = body.at_m or (math.inf,) * 3
    return math.hypot(
        *(max(abs(a - b) - half, 0.0) for a, b, half in zip(point_m[:2], at_m, body.half_m, strict=False))
    )


def _is_near(row: Sequence[Vector]) -> bool:
    """Whether a robot of the table's size reaches all points of a row."""
    return all(_REACH_M[0] < math.hypot(*point[:2]) < _REACH_M[1] for point in row)


def find_between(body: SceneObject, ends: Sequence[SceneObject]) -> Vector | None:
    """The point half-way between two objects [m]; None where an object has no room there, or without places."""
    (one, other), at_m = (each.at_m for each in ends), body.at_m
    if one is None or other is None or at_m is None:
        return None
    room_m = math.dist(one[:2], other[:2]) - sum(math.hypot(*each.half_m[:2]) for each in ends)
    middle_m = (round((one[0] + other[0]) / 2, 3), round((one[1] + other[1]) / 2, 3), at_m[2])
    return middle_m if room_m >= 2 * math.hypot(*body.half_m[:2]) else None


def is_between(body: SceneObject, ends: Sequence[SceneObject]) -> bool:
    """Whether two objects are seen from an object more than 120 degrees apart."""
    if body.at_m is None or any(each.at_m is None for each in ends):
        return False
    one, other = ([a - b for a, b in zip(each.at_m or (), body.at_m, strict=True)] for each in ends)
    return one[0] * other[0] + one[1] * other[1] < -0.5 * math.hypot(*one[:2]) * math.hypot(*other[:2])


def shift(at_m: Vector, side: str, view: float, by_m: float, origin_m: Vector = (0.0, 0.0, 0.0)) -> Vector:
    """A point so far to a side of another one, or toward an origin or away from it [m]."""
    away_m = math.dist(at_m[:2], origin_m[:2])
    x, y = SIDES.get(side) or [
        _ALONG[side] * (at - origin) / away_m for at, origin in zip(at_m[:2], origin_m, strict=False)
    ]
    return (round(at_m[0] + view * x * by_m, 3), round(at_m[1] + view * y * by_m, 3), round(at_m[2], 3))


def is_within(body: SceneObject, place: SceneObject) -> bool:
    """Whether the middle of an object is in a region."""
    at_m, center_m = body.at_m or (math.inf,) * 3, place.at_m or (0.0, 0.0, 0.0)
    return all(abs(at - center) <= half for at, center, half in zip(at_m, center_m, place.half_m, strict=True))


def is_tall(body: SceneObject) -> bool:
    """Whether a body is clearly higher than wide, so that lying is another posture than standing."""
    return body.half_m[2] > _TALL * max(body.half_m[:2])


def _is_under(body: SceneObject, owner: SceneObject) -> bool:
    (x, y, z), (x_m, y_m, z_m) = body.at_m or (0.0, 0.0, 0.0), owner.at_m or (0.0, 0.0, 0.0)
    return body.kind not in SURFACES and z < z_m and abs(x - x_m) <= owner.half_m[0] and abs(y - y_m) <= owner.half_m[1]


def _rank(body: SceneObject, kind: str, view: float, reference: Vector | None) -> float:
    x_m, y_m, _ = body.at_m or (0.0, 0.0, 0.0)
    if kind in SIDES:
        return view * (SIDES[kind][0] * x_m + SIDES[kind][1] * y_m)
    away_m = math.dist((x_m, y_m), (reference or (0.0, 0.0, 0.0))[:2])
    return away_m if kind == "far" else -away_m
