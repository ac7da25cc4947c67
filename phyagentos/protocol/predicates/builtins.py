"""The built-in predicates: each a small function from facts to a reading; see `library` for the contract.

Tolerances are chosen for table-top objects of 2 to 20 cm.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from msgspec.structs import replace

from phyagentos.geometry import (
    UP,
    Pose,
    Vector,
    compute_heading,
    compute_tilt,
    multiply,
    rotate,
    to_child,
    to_parent,
)
from phyagentos.protocol.predicates.bearing import (
    CONTACT_M,
    find_between,
    find_covered,
    find_other_bearer,
    find_prop,
    measure_below,
    measure_gap,
    measure_sunk,
)
from phyagentos.protocol.predicates.library import (
    UNCERTAINTY_STDS,
    Argument,
    ArgumentKind,
    FactMarginal,
    FactUnknown,
    Meaning,
    Place,
    PredicateDefinition,
    Reading,
    get_entity,
    get_place,
)
from phyagentos.protocol.predicates.stances import (
    POSTURE_RAD,
    UPRIGHT_RAD,
    measure_in_posture,
    measure_standing,
)
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.entity_geometry import (
    Top,
    compute_box_distance,
    compute_center,
    compute_centroid,
    compute_grasp_width,
    compute_least_turn,
    compute_lowest,
    compute_reach,
    find_bridged_top,
    find_tops_below,
    is_level_on,
    is_within,
    list_points,
)
from phyagentos.protocol.world.environment import CLOSED_M, CLOSES_AT, FRESH_S, OPENS_AT, Entity, Status, TargetState
from phyagentos.wording import compare_angles, compare_lengths, format_angle, format_length, format_share

RIM_M = 0.003  # how far below the rim the lowest point must lie: what rests on the rim is not inside
FLOOR_SLACK_M = 0.010  # contact penetration and the rounding of floors
FOOTPRINT_SLACK_M = 0.005  # how far past the edge the centroid may be where no uncertainty is stated
LEAN_RAD = 0.05  # 3 degrees: what lies on a surface leans by less, beside the stated uncertainty
FALLEN_RAD = 0.79  # 45 degrees
TURNED_RAD = 0.26  # 15 degrees
HALF_TURN = (0.0, 0.0, 0.0, 1.0)  # about the vertical
MOVED_M = 0.015  # settling and sensing noise stay below
MOVED_RAD = math.radians(10)
SAME_SIDE_M = 0.0005  # half sides that differ by less are equal
PAD_M = 0.012  # half of a pad, and the error of a pose in the hand
WIDTH_M = 0.006  # by which the opening may differ from what is between the pads, beside the stated uncertainty
PERCEIVED_STD_M = 0.0015  # of a position, where a pipeline states none: the median error of the one that ships
VESSEL_STD_M = 0.004  # the same of a vessel, of which thin walls and its filling are seen
PERCEIVED_STD_RAD = 0.02
SHIFT_STD_M = 0.005  # by which an object may have been shifted unseen as what hides it was put down on it
COARSE_RAD, COARSE_FACTOR = 0.11, 3.0  # few pixels fit many turns: their uncertainty is not normal
FACING_RAD = 0.1  # by which a base in its place may be turned
APART_M = 0.05  # by which a base may stand nearer or farther than it should
_BOUNDS = {"side_x_m": "side", "side_y_m": "side", "below_rim_m": "rim", "above_floor_m": "floor"}


def _find_position_uncertainty(view: View, *entities: Entity | None) -> float:
    """Uncertainty [m] of the distance of two positions; what is fixed and was not measured has none."""
    stds_m = (
        each.position_std_m or (VESSEL_STD_M if each.interior and not each.mechanism else PERCEIVED_STD_M)
        for each in entities
        if each is not None and (each.position_std_m or (each.movable and view.now.sensing != "truth"))
    )
    known = {each.name: each for each in entities if each is not None}
    shifts_m = (SHIFT_STD_M for each in known.values() if each.bears and each.bears not in known)
    return UNCERTAINTY_STDS * math.hypot(*stds_m, *shifts_m)


def _find_turn_uncertainty(view: View, *entities: Entity | None) -> float:
    """Uncertainty of orientations [rad]."""
    unstated = 0.0 if view.now.sensing == "truth" else PERCEIVED_STD_RAD
    return UNCERTAINTY_STDS * math.hypot(*(e.turn_std_rad or unstated for e in entities if e is not None and e.movable))


def _find_tilt_uncertainty(view: View, a: Entity) -> float:
    """Uncertainty of the angle of its z axis to the vertical [rad]."""
    return max(UNCERTAINTY_STDS * a.tilt_std_rad, _find_turn_uncertainty(view, a))


def measure_inside(view: View, a: Entity, b: str) -> Reading:
    """Let go of; centre and datum within the sides of the interior, datum and lowest point between floor and rim."""
    if (held := _find_hold(view, a)) is not None:
        return held
    box = get_place(view, b)
    if box.half_m == (0.0, 0.0, 0.0):
        return Reading(-1.0, {"interior": False}, f"{b} has no interior")
    points = [to_child(box.pose, point) for point in list_points(a)]
    up = rotate(box.pose.quaternion_wxyz, UP)
    low_m = compute_lowest(a, up) - sum(p * u for p, u in zip(box.pose.position_m, up, strict=True))
    slack_m = {
        "side_x_m": box.half_m[0] - max(abs(x) for x, _, _ in points),
        "side_y_m": box.half_m[1] - max(abs(y) for _, y, _ in points),
        "below_rim_m": box.half_m[2] - max(RIM_M + low_m, *(z for _, _, z in points[1:]), -math.inf),
        "above_floor_m": min(low_m, *(z for _, _, z in points[1:]), math.inf) + box.half_m[2] + FLOOR_SLACK_M,
    }
    scales = (box.half_m[0], box.half_m[1], box.half_m[2], box.half_m[2])
    margin, worst = min((s / max(h, 1e-3), name) for (name, s), h in zip(slack_m.items(), scales, strict=True))
    uncertainty_m = _find_position_uncertainty(view, a, view.now.entities.get(b))
    uncertainties_m = (uncertainty_m, uncertainty_m, *(uncertainty_m + _find_low_uncertainty(a, up),) * 2)
    sign = -1.0 if margin >= 0 else 1.0
    turned = min(
        (s + sign * d) / max(h, 1e-3) for s, d, h in zip(slack_m.values(), uncertainties_m, scales, strict=True)
    )
    off, bound = format_length(slack_m[worst]), _BOUNDS[worst]
    because = (
        f"{a.name} is inside {b}, {off} from its tightest bound ({bound})"
        if margin >= 0
        else f"{a.name} is not inside {b}, {off} beyond its bound ({bound})"
    )
    return Reading(margin, {name: round(s, 5) for name, s in slack_m.items()}, because, abs(margin - turned))


def measure_centred(view: View, a: Entity, b: Entity, tol_m: float) -> Reading:
    """Datums no further apart than `tol_m` as seen from above; centres where one has none."""
    *_, (one, other) = zip(list_points(a), list_points(b), strict=False)  # in the order: centre, datum
    apart_m = math.dist(one[:2], other[:2])
    because = f"{a.name} is {{}} off the middle of {b.name}"
    return _read_length("apart_m", apart_m, tol_m, because, _find_position_uncertainty(view, a, b))


def measure_on(view: View, a: Entity, b: str) -> Reading:
    """Let go of; middle over b's top, in contact, nothing between, nothing else may bear it, no datum below b's."""
    if (held := _find_hold(view, a)) is not None:
        return held
    of = view.now.entities.get(b)
    uncertainty_m = _find_position_uncertainty(view, a, of)
    allowed_m = CONTACT_M + uncertainty_m
    top = _find_sure_top(view, a, b, uncertainty_m, allowed_m + uncertainty_m)
    if top is None:
        return Reading(-1.0, {"over": False}, f"{a.name} is not above {b}")
    gap_m = measure_gap(a, of, top, uncertainty_m, allowed_m)
    measured: dict[str, float | str | bool] = {"over": True, "gap_m": round(gap_m, 5)}
    if (below_m := measure_below(a, of)) > 0.0:  # b fell over, or a leans on it from beside
        because = f"the datum of {a.name} is {format_length(below_m)} below that of {b}"
        return Reading(-below_m / allowed_m, measured, because, uncertainty_m / allowed_m)
    is_near = abs(gap_m) <= allowed_m + uncertainty_m
    between = find_between(view, a, b, top.point_m[2], gap_m + allowed_m) if is_near else None
    if between is not None:
        if reason := view.now.explain_unseen(between):
            raise FactUnknown(f"{reason}; it may be between {a.name} and {b}")
        return Reading(-1.0, measured | {"between": between.name}, f"{between.name} is between {a.name} and {b}")
    if is_near and (covered := find_covered(view, a, b, gap_m + allowed_m)) is not None:
        raise FactUnknown(f"no look has surely shown {covered}, and it may be between {a.name} and {b}")
    if is_near and of is not None and (other := find_other_bearer(view, a, of, allowed_m)) is not None:
        raise FactUnknown(f"{other.name} may bear {a.name} as well as {b}")
    own_rad = UNCERTAINTY_STDS * math.hypot(a.turn_std_rad, *a.lean_rad)  # whatever other pose fits as well
    leans = is_near and not is_level_on(a, top, LEAN_RAD + max(own_rad, _find_turn_uncertainty(view, a)))
    if leans and (prop := find_prop(view, a, b, top.point_m[2])) is not None:
        raise FactUnknown(f"{a.name} leans, and {prop.name} may bear it as well as {b}")
    if gap_m > allowed_m and (sunk_m := measure_sunk(view, a, b)) > allowed_m:
        because = f"{a.name} rests in the hollow of {b}, {format_length(sunk_m)} below its rim"
        return Reading(sunk_m / allowed_m, measured, because, uncertainty_m / allowed_m)
    gap, allowed = compare_lengths(gap_m, allowed_m)
    because = f"the lowest point of {a.name} is {gap} {_name_side(gap_m)} the top of {b}; up to {allowed} is allowed"
    return Reading(
        (allowed_m + uncertainty_m / 2 - abs(gap_m)) / allowed_m, measured, because, uncertainty_m / 2 / allowed_m
    )


def measure_above(view: View, a: Entity, b: str) -> Reading:
    """Let go of; middle over b's top and lowest point not below it: on b, or on what stands on b."""
    if (held := _find_hold(view, a)) is not None:
        return held
    of = view.now.entities.get(b)
    uncertainty_m = _find_position_uncertainty(view, a, of)
    allowed_m = CONTACT_M + uncertainty_m
    top = _find_sure_top(view, a, b, uncertainty_m, math.inf)
    if top is None:
        return Reading(-1.0, {"over": False}, f"{a.name} is not above {b}")
    gap_m = measure_gap(a, of, top, uncertainty_m, allowed_m)
    because = f"the lowest point of {a.name} is {format_length(gap_m)} {_name_side(gap_m)} the top of {b}"
    measured: dict[str, float | str | bool] = {"over": True, "gap_m": round(gap_m, 5)}
    return Reading(
        (gap_m + allowed_m + uncertainty_m / 2) / allowed_m, measured, because, uncertainty_m / 2 / allowed_m
    )


def _name_side(gap_m: float) -> str:
    return "above" if gap_m >= 0.0 else "below"


def _find_sure_top(view: View, a: Entity, b: str, uncertainty_m: float, near_m: float) -> Top | None:
    """As `_find_top`; unknown where the uncertainty decides whether a is over b, at less than `near_m` from its top."""
    if uncertainty_m:
        tops = (_find_top(view, a, b, slack_m) for slack_m in (-uncertainty_m, FOOTPRINT_SLACK_M + uncertainty_m))
        found = [abs(top.measure_gap(a)) for top in tops if top is not None]
        if len(found) == 1 and found[0] <= near_m:
            if bridged := find_bridged_top(view.now.entities.get(b), a, uncertainty_m):
                return bridged
            raise FactMarginal(f"whether {a.name} is above {b} is within the uncertainty of the measurement")
    top = _find_top(view, a, b, FOOTPRINT_SLACK_M)
    is_near = top is not None and abs(top.measure_gap(a)) <= CONTACT_M + uncertainty_m
    return top if is_near else find_bridged_top(view.now.entities.get(b), a, uncertainty_m) or top


def _find_low_uncertainty(a: Entity, up: Vector) -> float:
    """By how much its lowest point is off where it leans as the pixels alone say [m]."""
    (x, y, z), (i, j, k) = a.lean_rad, up
    down = (-i + y * k - z * j, -j + z * i - x * k, -k + x * j - y * i)
    length = math.hypot(*down)
    leaning = compute_reach(a, (down[0] / length, down[1] / length, down[2] / length))
    return abs(leaning - compute_reach(a, (-i, -j, -k)))


def _find_hold(view: View, a: Entity) -> Reading | None:
    """False for an object that a hand still holds: no lasting place. Unknown where fingers may touch both sides."""
    if a.held_by:
        return Reading(-1.0, {"held": True}, f"{a.name} is still held by {a.held_by}")
    if view.now.sensing != "truth" and a.movable:
        for name, state in view.now.targets.items():
            width_m, uncertainty_m = state.gripper_width_m, _find_position_uncertainty(view, a)
            between_m = compute_grasp_width(a, state.tcp, PAD_M, width_m) if width_m >= CLOSED_M else None
            if between_m is None and is_within(a, state.tcp.position_m, PAD_M):
                raise FactUnknown(f"{a.name} is around the fingers of {name}, and may hang on them")
            if (
                between_m is not None and between_m > width_m - WIDTH_M - uncertainty_m
            ):  # wider: the box around what is round
                raise FactUnknown(f"{a.name} is between the fingers of {name}, which may still hold it")
    return None


def _find_top(view: View, a: Entity, b: str, slack_m: float) -> Top | None:
    """The surface of b under the middle of a that is nearest to a, None where the middle of a is not over b."""
    center = to_parent(a.pose, compute_centroid(a))
    region = view.now.regions.get(b)
    if region is not None:
        x, y, _ = to_child(region.pose, center)
        over = abs(x) <= region.half_m[0] + slack_m and abs(y) <= region.half_m[1] + slack_m
        tops = [Top((center[0], center[1], region.pose.position_m[2] - region.half_m[2]), UP)] if over else []
    else:
        tops = find_tops_below(get_entity(view, b), center[0], center[1], slack_m)
    return min(tops, key=lambda top: abs(top.measure_gap(a)), default=None)


def measure_holding(view: View, target: str, a: str) -> Reading:
    """Both fingers touch it; where it is perceived: they press, it fits between them, and was seen to be lifted."""
    state = view.now.targets.get(target)
    if view.now.sensing != "truth":
        return _measure_perceived_holding(view, target, a, state)
    if state is None:
        if view.now.targets:
            raise FactUnknown(f"target {target} is not in the snapshot")
        held = get_entity(view, a, 0.5).held_by == target
        return Reading(1.0 if held else -1.0, {"held": held}, f"{a} is {'' if held else 'not '}held by {target}")
    held = a in state.holding
    holds = ", ".join(state.holding) or "nothing"
    because = f"{target} holds {holds}, its fingers {format_length(state.gripper_width_m)} apart"
    return Reading(1.0 if held else -1.0, {"held": held, "gripper_width_m": round(state.gripper_width_m, 5)}, because)


def _measure_perceived_holding(view: View, target: str, a: str, state: TargetState | None) -> Reading:
    entity = view.now.entities.get(a)
    if state is None:
        raise FactUnknown(f"target {target} is not in the snapshot")
    measured = {"grip_force_n": state.grip_force_n or 0.0, "gripper_width_m": round(state.gripper_width_m, 5)}
    if not state.is_gripping:
        because = f"the fingers of {target}, {format_length(state.gripper_width_m)} apart, press on nothing"
        return Reading(-1.0, {"held": False, **measured}, because)
    if entity is None:
        raise FactUnknown(f"{target} holds something, and {a} is not in the snapshot")
    if entity.held_by != target:
        get_entity(view, a, 0.5)  # seen elsewhere, or what the fingers touch may be it
        return Reading(-1.0, {"held": False, **measured}, f"{target} holds something, which is not {a}")
    _demand_grasp(view, entity, state)
    return Reading(
        1.0, {"held": True, **measured}, f"{target} holds {a}, which was seen in the hand since it was lifted"
    )


def _demand_grasp(view: View, a: Entity, state: TargetState) -> None:
    """What a grip alone does not show: the object is between the pads, as wide as they are apart, and came along."""
    between_m = compute_grasp_width(a, state.tcp, PAD_M, state.gripper_width_m)
    if between_m is None:
        raise FactUnknown(f"the fingers press on something, and {a.name} is not between them")
    if abs(between_m - state.gripper_width_m) > WIDTH_M + _find_position_uncertainty(view, a):
        width, between = compare_lengths(state.gripper_width_m, between_m)
        raise FactUnknown(f"the fingers are {width} apart, and {a.name} is {between} wide between them")
    if a.looks < 1:
        raise FactUnknown(f"no look has shown {a.name} in the hand since it was lifted")


def measure_at(view: View, a: Entity, place: Place, tol_m: float) -> Reading:
    """Centre within `tol_m` of a point, or of a place's box; a hand may hold it there."""
    _find_hold(view, a)
    distance_m = compute_box_distance(place.pose, place.half_m, compute_center(a))
    uncertainty_m = _find_position_uncertainty(view, a, view.now.entities.get(place.name))
    return _read_length("distance_m", distance_m, tol_m, f"{a.name} is {{}} from {place.name}", uncertainty_m)


def measure_contains(view: View, a: Entity, least: float) -> Reading:
    """At least so many small balls lie in its interior."""
    if a.contents is None or not view.now.time_s - a.contents.observed_at_s <= FRESH_S:
        raise FactUnknown(f"no look shows what is in {a.name} now")
    surely, most = a.contents.least, a.contents.most
    found = f"{surely}" if surely == most else f"{surely} to {most}"
    because = f"{a.name} holds {found} balls; at least {least:g} are wanted"
    middle, scale = (surely + most + 1) / 2, max(least, 1.0)
    return Reading((middle - least) / scale, {"least": surely, "most": most}, because, (most - surely) / 2 / scale)


def measure_near(view: View, a: Entity, b: Place, distance_m: float) -> Reading:
    """Distance between centres."""
    apart_m, uncertainty_m = _measure_apart(view, a, b)
    return _read_length("distance_m", apart_m, distance_m, f"{a.name} and {b.name} are {{}} apart", uncertainty_m)


def measure_visible(view: View, a: str) -> Reading:
    """It was seen in this look, or cannot move. What was never seen is not visible; what was just seen is unknown."""
    entity = view.now.entities.get(a)
    if entity is None:
        return Reading(-1.0, {"visible": False}, f"{a} is not in the snapshot")
    age_s = view.now.time_s - entity.observed_at_s
    reason = view.now.explain_unseen(entity)
    was_just_seen = entity.visible and entity.status is Status.HIDDEN and age_s <= FRESH_S
    if reason and (entity.is_unsure or was_just_seen):
        raise FactMarginal(reason)
    if reason and not view.now.sees:
        raise FactUnknown(reason)
    seen = entity.visible and not reason and not entity.bears
    return Reading(
        1.0 if seen else -1.0, {"visible": seen, "age_s": round(age_s, 3)}, f"{a} was seen {age_s:.1f} s ago"
    )


def measure_exists(view: View, a: str) -> Reading:
    """It is in the world. Absence proves nothing where the world is perceived rather than known."""
    if a in view.now.entities:
        get_entity(view, a)
        return Reading(1.0, {"exists": True}, f"{a} is in the snapshot")
    if view.now.sensing != "truth":
        raise FactUnknown(f"{a} is not in the snapshot, which does not prove that it is gone")
    return Reading(-1.0, {"exists": False}, f"{a} is not in the world")


def measure_upright(view: View, a: Entity) -> Reading:
    """Its z axis within 15 degrees of the vertical."""
    return _read_tilt(view, a, UPRIGHT_RAD, 1.0, "up to {} is upright")


def measure_fallen(view: View, a: Entity) -> Reading:
    """Its z axis more than 45 degrees from the vertical."""
    return _read_tilt(view, a, FALLEN_RAD, -1.0, "more than {} is fallen")


def measure_turned(view: View, a: Entity, heading_rad: float, tol_rad: float) -> Reading:
    """Its turn about the vertical within `tol_rad` of a heading; unknown of perceived sides that look alike."""
    pose = a.pose
    aside = replace(a, pose=Pose(pose.position_m, multiply(HALF_TURN, pose.quaternion_wxyz)))
    if view.now.sensing != "truth" and compute_least_turn(a, aside, SAME_SIDE_M, MOVED_M) < MOVED_RAD:
        raise FactUnknown(f"the sides of {a.name} look alike, so no camera shows how far it is turned")
    off_rad = abs(math.remainder(compute_heading(pose.quaternion_wxyz) - heading_rad, math.tau))
    off, allowed = compare_angles(off_rad, tol_rad)
    because = f"{a.name} is turned {off} from the heading; up to {allowed} is allowed"
    return Reading(
        1.0 - off_rad / tol_rad, {"off_rad": round(off_rad, 5)}, because, _find_turn_uncertainty(view, a) / tol_rad
    )


def measure_moved(view: View, a: Entity) -> Reading:
    """More than 1.5 cm or 10 degrees from where it was in the initial snapshot; a turn onto itself is none."""
    if view.initial is None:
        raise FactUnknown("there is no initial snapshot")
    try:
        was = get_entity(View(now=view.initial), a.name)
    except FactUnknown as reason:
        raise FactUnknown(f"in the initial snapshot, {reason}") from reason
    moved_m = math.dist(a.pose.position_m, was.pose.position_m)
    is_exact = view.now.sensing == "truth"
    uncertainty_m, uncertainty_rad = _find_position_uncertainty(view, a, was), _find_turn_uncertainty(view, a, was)
    turned_rad = compute_least_turn(a, was, *((0.0,) if is_exact else (SAME_SIDE_M, uncertainty_m)))
    margin = max(moved_m / MOVED_M, turned_rad / MOVED_RAD) - 1.0
    because = f"{a.name} moved {format_length(moved_m)} and turned {format_angle(turned_rad)}"
    least_rad = turned_rad if is_exact or turned_rad < MOVED_RAD else compute_least_turn(a, was, uncertainty_m)
    if max(a.tilt_std_rad, was.tilt_std_rad) > MOVED_RAD:  # another pose fits as well, which is turned, too
        least_rad = 0.0
    coarse = COARSE_FACTOR if uncertainty_rad > COARSE_RAD else 1.0
    least = max((moved_m - uncertainty_m) / MOVED_M, (least_rad - coarse * uncertainty_rad) / MOVED_RAD)
    most = max((moved_m + uncertainty_m) / MOVED_M, (turned_rad + uncertainty_rad) / MOVED_RAD)
    uncertainty = margin + 1.0 - least if margin >= 0 else most - 1.0 - margin
    return Reading(margin, {"moved_m": round(moved_m, 5), "turned_rad": round(turned_rad, 5)}, because, uncertainty)


def measure_open(view: View, a: Entity) -> Reading:
    """Its joint is at least 90 % open, or as far as its mechanism says."""
    return _read_opening(view, a, a.mechanism.opens_at if a.mechanism is not None else OPENS_AT, 1.0)


def measure_closed(view: View, a: Entity) -> Reading:
    """Its joint is at most 10 % open, or as little as its mechanism says."""
    return _read_opening(view, a, a.mechanism.closes_at if a.mechanism is not None else CLOSES_AT, -1.0)


def measure_tilt(view: View, a: Entity) -> Reading:
    """Angle between its z axis and the vertical [rad]."""
    tilt_rad = compute_tilt(a.pose)
    side = " or rests on a side of nearly the same size" if a.tilt_std_rad > math.pi / 8 else ""
    because = f"{a.name} leans {format_angle(tilt_rad)}{side}"
    return Reading(tilt_rad, {"tilt_rad": round(tilt_rad, 5)}, because, _find_tilt_uncertainty(view, a))


def measure_height(view: View, a: Entity) -> Reading:
    """Height of its lowest point above the world's origin [m]."""
    height_m = compute_lowest(a)
    because = f"the lowest point of {a.name} is at a height of {height_m:.3f} m"
    return Reading(height_m, {"height_m": round(height_m, 5)}, because, _find_position_uncertainty(view, a))


def measure_distance(view: View, a: Entity, b: Place) -> Reading:
    """Distance between centres [m]."""
    apart_m, uncertainty_m = _measure_apart(view, a, b)
    because = f"{a.name} and {b.name} are {format_length(apart_m)} apart"
    return Reading(apart_m, {"distance_m": round(apart_m, 5)}, because, uncertainty_m)


def measure_speed(view: View, a: Entity) -> Reading:
    """Magnitude of its linear velocity [m/s]; one look at an object does not show it."""
    if view.now.sensing == "perceived" and a.movable and a.looks < 2 and a.speed_m_s == 0.0:
        raise FactUnknown(f"{a.name} was looked at once, which does not show whether it moves")
    return Reading(a.speed_m_s, {"speed_m_s": round(a.speed_m_s, 5)}, f"{a.name} moves at {a.speed_m_s:.3f} m/s")


def measure_docked(view: View, target: str, place: Place, standoff_m: float) -> Reading:
    """Its base rests with its origin in a region, headed as that, or so far from the centre of an object, facing it."""
    state = view.now.targets.get(target)
    if state is None or state.base is None:
        raise FactUnknown(f"where the base of {target} stands is not in the snapshot")
    x, y, heading_rad = state.base
    _, _, z = place.pose.position_m
    if place.name in view.now.regions:
        ahead = rotate(place.pose.quaternion_wxyz, (1.0, 0.0, 0.0))
        local = to_child(place.pose, (x, y, z))
        off_m, allowed_m = max((abs(p) - h, h) for p, h in zip(local[:2], place.half_m[:2], strict=True))
        off_m += allowed_m
    else:
        ahead = (place.pose.position_m[0] - x, place.pose.position_m[1] - y, 0.0)
        off_m, allowed_m = abs(math.hypot(*ahead) - standoff_m), APART_M
    turned_rad = abs(math.remainder(heading_rad - math.atan2(ahead[1], ahead[0]), math.tau))
    (off, most), (turned, turn) = compare_lengths(off_m, allowed_m), compare_angles(turned_rad, FACING_RAD)
    because = f"the base of {target} is {off} off {place.name} and turned {turned}; up to {most} and {turn} is allowed"
    margin = 1.0 - max(off_m / allowed_m, turned_rad / FACING_RAD)
    uncertainty = _find_position_uncertainty(view, view.now.entities.get(place.name)) / allowed_m
    return Reading(margin, {"off_m": round(off_m, 5), "turned_rad": round(turned_rad, 5)}, because, uncertainty)


def measure_metric(view: View, name: str) -> Reading:
    """A number that was measured during the session, within its own `NAME_error`; unknown when not measured."""
    if name not in view.metrics:
        raise FactUnknown(f"nothing measured {name}")
    value = view.metrics[name]
    uncertainty = view.metrics.get(f"{name}_error", 0.0)
    return Reading(value, {name: round(value, 6)}, f"{name} is {value:.4g}", uncertainty)


def measure_unstated(view: View) -> Reading:
    """Placeholder until a person writes the criterion; always unknown, so never a success."""
    del view
    raise FactUnknown("no criterion is stated yet: write a predicate in place of unstated()")


def _measure_apart(view: View, a: Entity, b: Place) -> tuple[float, float]:
    """The distance of two centres, and its uncertainty [m]."""
    return math.dist(compute_center(a), b.pose.position_m), _find_position_uncertainty(
        view, a, view.now.entities.get(b.name)
    )


def _read_length(name: str, length_m: float, most_m: float, because: str, uncertainty_m: float) -> Reading:
    """A length that may be up to `most_m`; `because` has a place for it."""
    length, most = compare_lengths(length_m, most_m)
    scale_m = max(most_m, 1e-3)
    because = f"{because.format(length)}; up to {most} is allowed"
    return Reading((most_m - length_m) / scale_m, {name: round(length_m, 5)}, because, uncertainty_m / scale_m)


def _read_tilt(view: View, a: Entity, limit_rad: float, sign: float, meaning: str) -> Reading:
    tilt_rad = compute_tilt(a.pose)
    tilt, limit = compare_angles(tilt_rad, limit_rad)
    because = f"{a.name} leans {tilt}; {meaning.format(limit)}"
    uncertainty = _find_tilt_uncertainty(view, a) / limit_rad
    return Reading(sign * (1.0 - tilt_rad / limit_rad), {"tilt_rad": round(tilt_rad, 5)}, because, uncertainty)


def _read_opening(view: View, a: Entity, limit: float, sign: float) -> Reading:
    """How far its joint is beyond a limit, as a share of the travel."""
    if a.joint is None:
        raise FactUnknown(f"{a.name} has no joint that was observed")
    uncertainty = 0.0
    if a.mechanism is not None:
        find_uncertainty = _find_turn_uncertainty if a.mechanism.kind == "hinge" else _find_position_uncertainty
        uncertainty = find_uncertainty(view, a) / a.mechanism.travel
    because = f"{a.name} is {format_share(a.joint)} open"
    return Reading(sign * (a.joint - limit), {"opening": a.joint}, because, uncertainty)


_A = Argument("a", ArgumentKind.ENTITY)
_IN = Argument("b", ArgumentKind.CONTAINER)
_ON = Argument("b", ArgumentKind.ENTITY)
_B = Argument("b", ArgumentKind.PLACE)
_PLACE = Argument("place", ArgumentKind.PLACE)
_TARGET = Argument("target", ArgumentKind.TARGET)


def _define(name: str, measure: Callable[..., Reading], *arguments: Argument, **more: Any) -> PredicateDefinition:
    description = (measure.__doc__ or "").splitlines()[0]
    return PredicateDefinition(name=name, arguments=arguments, measure=measure, description=description, **more)


_number = partial(_define, is_number=True, lasting=False)
_state = partial(_define, at_rest=True)

BUILTINS: tuple[PredicateDefinition, ...] = (
    _state("inside", measure_inside, _A, _IN, meaning=Meaning.INSIDE),
    _state("on", measure_on, _A, _IN, implies="above", meaning=Meaning.ON),
    _state("above", measure_above, _A, _IN),
    _state("at", measure_at, _A, _PLACE, Argument("tol_m", ArgumentKind.NUMBER, 0.03, least=0.0), meaning=Meaning.AT),
    _state("centred", measure_centred, _A, _ON, Argument("tol_m", ArgumentKind.NUMBER, 0.03, least=0.0)),
    _state(
        "near", measure_near, _A, _B, Argument("distance_m", ArgumentKind.NUMBER, 0.10, least=0.0), meaning=Meaning.NEAR
    ),
    _state(
        "contains",
        measure_contains,
        _A,
        Argument("least", ArgumentKind.NUMBER, 1.0, least=0.0),
        meaning=Meaning.CONTAINS,
    ),
    _state("upright", measure_upright, _A, excludes=("fallen",), meaning=Meaning.UPRIGHT),
    _state("fallen", measure_fallen, _A, excludes=("upright",), meaning=Meaning.FALLEN),
    _state(
        "turned",
        measure_turned,
        _A,
        Argument("heading_rad", ArgumentKind.NUMBER),
        Argument("tol_rad", ArgumentKind.NUMBER, TURNED_RAD, least=0.0),
        meaning=Meaning.TURNED,
    ),
    _state("open", measure_open, _A, excludes=("closed",), meaning=Meaning.OPEN),
    _state("closed", measure_closed, _A, excludes=("open",), meaning=Meaning.CLOSED),
    _define("moved", measure_moved, _A, lasting=False, meaning=Meaning.MOVED),
    _define("visible", measure_visible, _A, lasting=False, by_name=True, meaning=Meaning.VISIBLE),
    _define("exists", measure_exists, _A, by_name=True, meaning=Meaning.EXISTS),
    _define(
        "holding", measure_holding, _TARGET, _A, max_age_s=0.5, lasting=False, by_name=True, meaning=Meaning.HOLDING
    ),
    _define(
        "in_posture",
        measure_in_posture,
        _TARGET,
        Argument("posture", ArgumentKind.POSTURE),
        Argument("tol_rad", ArgumentKind.NUMBER, POSTURE_RAD, least=0.0),
        lasting=False,
    ),
    _define("standing", measure_standing, _TARGET, Argument("least_m", ArgumentKind.NUMBER, least=0.0), lasting=False),
    _define("docked", measure_docked, _TARGET, _PLACE, Argument("standoff_m", ArgumentKind.NUMBER, 0.4, least=0.0)),
    _number("metric", measure_metric, Argument("name", ArgumentKind.METRIC)),
    _define("unstated", measure_unstated, lasting=False),
    _number("tilt", measure_tilt, _A, unit="rad"),
    _number("height", measure_height, _A),
    _number("distance", measure_distance, _A, _B, unit="m"),
    _number("speed", measure_speed, _A, max_age_s=0.5),
)
