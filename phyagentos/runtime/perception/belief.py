"""From one set of frames and the belief before it to the belief after it: the core of the pipeline, a pure function.

Fixed objects are searched near their nominal places, held objects follow the hand, the others are found by colour and
form. An object that is not found is hidden where its place cannot be seen, and gone where its place is seen and empty.
"""

import math
from collections.abc import Collection, Mapping

import msgspec
import numpy as np

from phyagentos.geometry import as_pose, compute_rotation, compute_rotation_vector, turn
from phyagentos.protocol.sessions.looks import Pointer
from phyagentos.protocol.world.environment import LIFTED_M, Change, Entity, Pose, Region, Shape, Status, TargetState
from phyagentos.runtime.perception.articulated import place_articulated
from phyagentos.runtime.perception.association import Match, associate, exchange_alternatives
from phyagentos.runtime.perception.contents import count_balls, find_bearing
from phyagentos.runtime.perception.fitting import SURE_POINTS, Fit, choose_symmetric, is_upright, stand_up
from phyagentos.runtime.perception.fixed_objects import find_part, measure_fixed
from phyagentos.runtime.perception.forms import Form
from phyagentos.runtime.perception.grip import Hand, carry, check_hand, find_held, let_go
from phyagentos.runtime.perception.inventory import ALIKE, Inventory, ObjectModel
from phyagentos.runtime.perception.segmentation import is_among
from phyagentos.runtime.perception.solids import Array, Solids
from phyagentos.runtime.perception.views import CameraView, Cloud, Views, compute_visibility

SOURCE, FILLING = "rgbd", "rgbd filling"
RIM_M = 0.008  # of a vessel: how far its filling may stand out, and how far its pose may be off
FILLING_POINTS = 4  # so many pixels show that there is some
STILL_M, STILL_RAD = 0.008, 0.14  # an object that comes out this near to where it was has not moved
STILL_STDS = np.array([2.0, 3.0])  # or nearer than so many deviations; poses of few pixels differ by many small turns
FUSE_MAX = 5  # a mean over more looks would follow too slowly
FIXED_LOOKS = 4  # after so many a fixed object is known
GONE_FRACTION = 0.6  # of its surface seen through
SEEN_FRACTION = 0.25  # less of it in view proves nothing
NEAR_FIXED_M = 0.004  # what is this near to a fixed object and of a colour like it belongs to it
HAND_M = 0.008
PART_M = 0.01  # what is this near to a part of a mechanism belongs to it
SUNK_UNCERTAINTY_M = 0.015  # a pose so deep in another solid is hardly believed
SEEN_MOVED_M = 0.01  # less than this is the noise of looking
CHANGES_MAX = 40  # a longer list helps no reader
SHOWS_MORE = 1.5  # as many pixels: what another pose explained as well before, such a look may exclude
KEPT_SHARE = 0.95  # of the confidence, after a look that misses it
SPEED_S = (0.08, 2.0)  # a speed needs two looks this far apart


def update_belief(
    inventory: Inventory,
    before: Mapping[str, Entity],
    views: Views,
    cloud: Cloud,
    state: TargetState,
    *,
    hand: Hand,
    time_s: float,
    focus: Collection[str] = (),
) -> dict[str, Entity]:
    """The entities after a look at time_s, the stamp of its newest frame; only at objects of `focus`, unless empty."""
    entities = check_hand(inventory, follow_hand(inventory, before, state, hand, time_s), cloud, state, hand)
    entities.update(inventory.known)
    wanted = {name: item for name, item in inventory.objects.items() if not focus or name in focus}
    if not focus:
        _look_at_fixed(inventory, entities, views, cloud, time_s)
    held = [name for name, entity in entities.items() if entity.status is Status.HELD]
    rest = _leave_out(cloud, inventory, entities, held)
    loose = {name: item for name, item in wanted.items() if item.template.movable and name not in held}
    parts = [name for name, item in inventory.objects.items() if item.path is not None and item.look]
    for name in [name for name in parts if name in loose]:
        _look_at_part(loose.pop(name), entities, rest, views, time_s)
    shown = [Solids.place(entities[name], inventory.objects[name].solids) for name in parts if name in entities]
    for solids in shown:
        rest = rest.take(solids.measure(rest.points_m) > PART_M)
    filling = {name: loose.pop(name) for name in list(loose) if loose[name].vessel is not None}
    beside = {name: item for name, item in inventory.objects.items() if item.template.movable and name not in held}
    beside = {name: item for name, item in beside.items() if item.vessel is None and name not in parts}
    matches = associate(beside, entities, rest, views, inventory.map, inventory.palette)
    for name, item in loose.items():
        match, entity = matches.get(name), entities.get(name)
        if match is not None:
            found = _see(item, entity, match, rest, views, time_s)
            entities[name] = found if before else msgspec.structs.replace(found, still_since_s=None)
        elif entity is not None:
            entities[name] = _miss(item, entity, views)
    entities = exchange_alternatives(entities, matches.keys() & loose.keys())
    seen = {name: entity for name, entity in entities.items() if entity.observed_at_s == time_s}
    if not held and not focus and (taken := find_held(seen, state, inventory, hand)) is not None:
        was = before.get(taken.name, taken).pose.position_m  # a worker that was lost may have gripped it unseen
        is_lifted = taken.pose.position_m[2] - was[2] > LIFTED_M  # and this look shows it in the hand
        taken = msgspec.structs.replace(taken, taken_at_m=was, looks=int(is_lifted))
        entities[taken.name] = carry(taken, state, hand)
    _look_at_filling(inventory, filling, entities, rest, views, time_s)
    for name, contents in count_balls(inventory, entities, cloud, views, time_s).items() if inventory.balls else ():
        if not focus or name in focus:
            entities[name] = msgspec.structs.replace(entities[name], contents=contents)
    return find_bearing(_carry_contents(inventory, before, place_articulated(inventory.articulated, entities)))


def follow_hand(
    inventory: Inventory, before: Mapping[str, Entity], state: TargetState, hand: Hand, time_s: float
) -> dict[str, Entity]:
    """The entities by touch alone: a held object moves with the hand, a released one stays at its release pose."""
    entities = dict(before)
    held = [entity for entity in before.values() if entity.status is Status.HELD]
    if not state.is_gripping:
        entities |= {entity.name: let_go(carry(entity, state, hand)) for entity in held}
        return entities
    taken = held[0] if held else find_held(before, state, inventory, hand)
    if taken is not None:
        entities[taken.name] = msgspec.structs.replace(carry(taken, state, hand), observed_at_s=time_s)
        entities = _carry_contents(inventory, before, place_articulated(inventory.articulated, entities))
    return entities


def lose_sight(entities: Mapping[str, Entity], names: Collection[str] = ()) -> dict[str, Entity]:
    """The entities after a look that shows nothing: what may have moved is hidden; of `names`, unless empty."""
    return {
        name: msgspec.structs.replace(entity, status=Status.HIDDEN)
        if entity.movable and entity.status is Status.SEEN and (not names or name in names)
        else entity
        for name, entity in entities.items()
    }


def read_regions(inventory: Inventory, entities: Mapping[str, Entity]) -> dict[str, Region]:
    """The named regions, those of a body where that body was measured."""
    regions = {}
    for prior in inventory.regions:
        body = entities.get(prior.body) if prior.body is not None else None
        if prior.body is not None and body is None:
            continue
        pose = Pose(prior.center_m)
        if body is not None:
            rotation = compute_rotation(body.pose.quaternion_wxyz)
            pose = as_pose(rotation, rotation @ np.array(prior.center_m) + np.array(body.pose.position_m))
        regions[prior.name] = Region(
            name=prior.name, pose=pose, half_m=prior.half_m, alternatives=(prior.turned,) if prior.turned else ()
        )
    return regions


def _look_at_fixed(
    inventory: Inventory, entities: dict[str, Entity], views: Views, cloud: Cloud, time_s: float
) -> None:
    """Measure what does not move, until it is known."""
    for item in inventory.objects.values():
        entity = entities.get(item.name)
        if item.template.movable or (entity is not None and entity.looks >= FIXED_LOOKS):
            continue
        found = measure_fixed(item, entities, views, cloud)
        if found is not None:
            entities[item.name] = _fuse(item, entity, found, time_s, ())


def _look_at_part(item: ObjectModel, entities: dict[str, Entity], rest: Cloud, views: Views, time_s: float) -> None:
    """Measure a part of a mechanism."""
    entity = entities.get(item.name)
    if (part := find_part(item, rest, views)) is not None:
        entities[item.name] = _see(item, entity, part, rest, views, time_s)
    elif entity is not None:
        entities[item.name] = _miss(item, entity, views)


def _fuse(item: ObjectModel, entity: Entity | None, found: Fit, time_s: float, evidence: tuple[str, ...]) -> Entity:
    """The measured pose, averaged with those before where the object has not moved.

    What is averaged is what the pixels give: whether that is upright is concluded from the average, each time anew.
    """
    looks, freely, position, other_rad = 1, found.freely, found.position_m, found.other_tilt_rad
    stds = (uncertainty := found.uncertainty.of_measured(item.template.size_std_m)).total
    speed, since_s = 0.0, time_s
    if entity is None:
        freely = freely @ item.symmetries[int((freely @ item.symmetries)[:, 2, 2].argmax())]
    else:
        was = turn(np.array(entity.lean_rad)) @ compute_rotation(entity.pose.quaternion_wxyz)
        freely = choose_symmetric(item, freely, was)
        moved = position - np.array(entity.pose.position_m)
        shown = was @ item.turns  # what a form does not show has not turned
        turned = shown @ shown.T @ compute_rotation_vector(freely @ was.T)
        before = np.array([entity.position_std_m, entity.turn_std_rad])
        is_still = _is_still(moved, turned, np.hypot(stds, before))
        if is_still:
            since_s = entity.observed_at_s if entity.still_since_s is None else entity.still_since_s
        if entity.looks and is_still:
            looks = min(entity.looks + 1, FUSE_MAX)
            gain = uncertainty.compute_gain(before)
            position = np.array(entity.pose.position_m) + gain[0] * moved
            freely = turn(gain[1] * turned) @ was
            stds, kept_rad = uncertainty.fuse(before), _find_other_tilt(entity)
            other_rad = other_rad if _shows_more(evidence, entity.evidence) else max(other_rad, kept_rad)
        elif entity.looks and SPEED_S[0] <= time_s - entity.observed_at_s <= SPEED_S[1]:
            speed = float(np.linalg.norm(moved)) / (time_s - entity.observed_at_s)
    place_m, turn_rad = stds.tolist()
    rotation = stand_up(freely) if item.form is not Form.BALL and is_upright(freely, turn_rad) else freely
    lean = compute_rotation_vector(freely @ rotation.T)
    return msgspec.structs.replace(
        item.template,
        pose=as_pose(rotation, position),
        shapes=_stretch(item.template.shapes, found.stretch),
        observed_at_s=time_s,
        visible=True,
        status=Status.SEEN,
        speed_m_s=speed,
        still_since_s=since_s if item.template.movable else None,
        confidence=_rate(found, entity.confidence if entity is not None else 0.0),
        source=SOURCE,
        looks=looks,
        position_std_m=place_m,
        turn_std_rad=turn_rad,
        tilt_std_rad=math.hypot(turn_rad, *lean, other_rad / 2),
        lean_rad=lean,
        evidence=evidence,
    )


def _look_at_filling(
    inventory: Inventory,
    filling: Mapping[str, ObjectModel],
    entities: dict[str, Entity],
    rest: Cloud,
    views: Views,
    time_s: float,
) -> None:
    """Measure what fills vessels, in them or spilt beside them."""
    outside, filled = _take_filling(filling, entities, rest)
    spilt = associate(filling, entities, outside, views, inventory.map)
    for name, item in filling.items():
        if name in spilt:
            entities[name] = _see(item, entities.get(name), spilt[name], outside, views, time_s)
        else:
            _fill(item, entities, filled, time_s)


def _is_still(moved: Array, turned: Array, stds: Array) -> bool:
    """Whether a displacement [m] and a turn [rad] are none, given the deviations of both (2,)."""
    place_m, turn_rad = STILL_STDS * stds
    moved_m, turned_rad = float(np.linalg.norm(moved)), float(np.linalg.norm(turned))
    return bool(moved_m < max(STILL_M, place_m) and turned_rad < max(STILL_RAD, turn_rad))


def _find_other_tilt(entity: Entity) -> float:
    """The part of a stated uncertainty of the tilt that comes from another pose that fits as well [rad]."""
    square = entity.tilt_std_rad**2 - entity.turn_std_rad**2 - sum(each * each for each in entity.lean_rad)
    return 2.0 * math.sqrt(max(square, 0.0))


def _shows_more(evidence: Collection[str], before: Collection[str]) -> bool:
    """Whether a look shows an object to all the cameras that saw it and another one, in half as many pixels again."""
    now, then = ({each.camera: each.area_px for each in Pointer.parse_all(part)} for part in (evidence, before))
    return now.keys() > then.keys() and sum(now.values()) > SHOWS_MORE * sum(then.values())


def _see(item: ObjectModel, entity: Entity | None, match: Match, cloud: Cloud, views: Views, time_s: float) -> Entity:
    found = match.fit
    seen = cloud.take(match.points)
    evidence = tuple(_point_at(views[index], seen, index) for index in np.unique(seen.view_index).tolist())
    placed = _fuse(item, entity, found, time_s, evidence)
    local = (seen.points_m - found.position_m) @ found.rotation
    x, y, z = np.round(np.percentile(local, 98, axis=0) - np.percentile(local, 2, axis=0), 4).tolist()
    named_at_s = time_s if match.is_renamed or entity is None else entity.named_at_s
    return msgspec.structs.replace(
        placed,
        extent_m=(x, y, z),
        alternatives=match.alternatives,
        named_at_s=named_at_s if match.alternatives else 0.0,
    )


def _point_at(view: CameraView, seen: Cloud, index: int) -> str:
    """Pointer to the pixels of an object in one picture."""
    pixels = seen.pixels[seen.view_index == index]
    (left, top), (right, bottom) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
    box = (view.origin_px[0] + left, view.origin_px[1] + top, right - left + 1, bottom - top + 1)
    return str(Pointer(view.camera, view.time_s, box))


def _miss(item: ObjectModel, entity: Entity, views: Views) -> Entity:
    visibility = compute_visibility(
        item,
        rotation=compute_rotation(entity.pose.quaternion_wxyz),
        position_m=np.array(entity.pose.position_m),
        views=views,
    )
    shown = visibility.confirmed + visibility.contradicted
    if shown > SEEN_FRACTION * (shown + visibility.hidden) and visibility.contradicted_fraction > GONE_FRACTION:
        return msgspec.structs.replace(entity, status=Status.GONE, visible=False, confidence=0.1, looks=0)
    return msgspec.structs.replace(entity, status=Status.HIDDEN, confidence=round(KEPT_SHARE * entity.confidence, 3))


def _take_filling(
    filling: Mapping[str, ObjectModel], entities: Mapping[str, Entity], cloud: Cloud
) -> tuple[Cloud, dict[str, bool]]:
    """The points outside of vessels, and which vessels are visibly filled."""
    keep = np.ones(len(cloud.points_m), dtype=np.bool_)
    filled: dict[str, bool] = {}
    for name in dict.fromkeys(item.vessel for item in filling.values()):
        vessel = entities.get(name or "")
        inside = vessel.interior if vessel is not None else None
        if vessel is None or inside is None or name is None:
            continue
        colors = [item.colors[0] for item in filling.values() if item.vessel == name]
        local = (cloud.points_m - vessel.pose.position_m) @ compute_rotation(vessel.pose.quaternion_wxyz)
        within = np.all(np.abs(local - inside.center_m) <= np.array(inside.half_m) + RIM_M, axis=1)
        within &= is_among(cloud.colors, colors)
        keep &= ~within
        filled[name] = int(within.sum()) >= FILLING_POINTS
    return cloud.take(keep), filled


def _fill(item: ObjectModel, entities: dict[str, Entity], filled: Mapping[str, bool], time_s: float) -> None:
    """Places a part of a filling that is not seen outside: in its vessel, where that is visibly filled."""
    vessel, entity = entities.get(item.vessel or ""), entities.get(item.name)
    if vessel is None:
        return
    rotation = compute_rotation(vessel.pose.quaternion_wxyz)
    offset = np.array(item.template.pose.position_m)
    pose = as_pose(rotation, rotation @ offset + np.array(vessel.pose.position_m))
    if filled.get(vessel.name):
        entities[item.name] = msgspec.structs.replace(
            item.template, pose=pose, observed_at_s=time_s, status=Status.SEEN, confidence=0.7, source=FILLING, looks=1
        )
    elif entity is not None and entity.source == FILLING and vessel.status in (Status.HELD, Status.HIDDEN):
        entities[item.name] = msgspec.structs.replace(entity, pose=pose, status=Status.HIDDEN, confidence=0.4)
    elif entity is not None:
        entities[item.name] = msgspec.structs.replace(entity, status=Status.GONE, visible=False, confidence=0.1)


def _leave_out(cloud: Cloud, inventory: Inventory, entities: Mapping[str, Entity], held: list[str]) -> Cloud:
    """The points that neither a fixed object nor a held one explains."""
    keep = np.ones(len(cloud.points_m), dtype=np.bool_)
    loose = {item.colors[0] for item in inventory.objects.values() if item.template.movable}
    for name, item in inventory.objects.items():
        entity = entities.get(name)
        if entity is None or (item.template.movable and name not in held):
            continue
        alike = [c for c in loose if c in item.colors or _is_like(inventory, c, item)]
        among, margin = is_among(cloud.colors, (*alike, *item.colors)), HAND_M if name in held else NEAR_FIXED_M
        if not among.any():
            continue
        rotation = compute_rotation(entity.pose.quaternion_wxyz)
        local = (cloud.points_m[among] - entity.pose.position_m) @ rotation
        solids = Solids.of(entity.shapes).near(local, margin)
        if solids.kinds:
            keep[among] &= solids.measure(local) > margin
    return cloud.take(keep)


def _is_like(inventory: Inventory, color: int, item: ObjectModel) -> bool:
    """Whether a colour is within `ALIKE` of one of the object's."""
    one = inventory.palette[color]
    others = inventory.palette[list(item.colors)]
    hues = others / others.sum(axis=1, keepdims=True)
    return bool((np.linalg.norm(one / one.sum() - hues, axis=1) < ALIKE).any())


def _carry_contents(inventory: Inventory, before: Mapping[str, Entity], after: dict[str, Entity]) -> dict[str, Entity]:
    """Moves unseen contents along with their vessel."""
    for name, known in (inventory.objects | inventory.articulated).items():
        vessel, was = after.get(name), before.get(name)
        inside = known.template.interior
        if vessel is None or was is None or inside is None or not known.template.movable or vessel.pose == was.pose:
            continue
        old, new = compute_rotation(was.pose.quaternion_wxyz), compute_rotation(vessel.pose.quaternion_wxyz)
        for other, entity in list(after.items()):
            earlier = before.get(other)
            is_unseen = (
                entity.status in (Status.HIDDEN, Status.SEEN) and earlier is not None and entity.pose == earlier.pose
            )
            if other == name or not entity.movable or not is_unseen or earlier is None:
                continue
            local = old.T @ (np.array(earlier.pose.position_m) - np.array(was.pose.position_m))
            if np.all(np.abs(local - inside.center_m) <= inside.half_m):
                moved = as_pose(
                    rotation=new @ old.T @ compute_rotation(earlier.pose.quaternion_wxyz),
                    position_m=new @ local + np.array(vessel.pose.position_m),
                )
                after[other] = msgspec.structs.replace(entity, pose=moved)
    return after


def _stretch(shapes: tuple[Shape, ...], factor: float) -> tuple[Shape, ...]:
    if factor == 1.0:
        return shapes
    return tuple(
        Shape(
            shape.kind,
            (*shape.size_m[:-1], shape.size_m[-1] * factor),
            Pose((*shape.pose.position_m[:2], shape.pose.position_m[2] * factor), shape.pose.quaternion_wxyz),
        )
        for shape in shapes
    )


def _rate(found: Fit, before: float) -> float:
    """Confidence: the visible share of the expected surface, times the quality of the fit.

    Where the pose before was kept, it is that of `before`.
    """
    if found.is_kept:
        return before
    shown = 1.0 - found.visibility.contradicted_fraction
    fitting = float(np.exp(-((found.rms_m / 0.006) ** 2)))
    enough = min(1.0, found.count / SURE_POINTS)
    possible = float(np.exp(-((found.sunk_m / SUNK_UNCERTAINTY_M) ** 2)))
    return round(shown * (0.4 + 0.6 * fitting) * enough * possible, 3)


def find_changes(before: Mapping[str, Entity], after: Mapping[str, Entity]) -> tuple[Change, ...]:
    """Every object that appeared, moved, or changed its status; the farthest moves first."""
    changes = [change for name, entity in after.items() if (change := _compare(before.get(name), entity)) is not None]
    return tuple(sorted(changes, key=lambda change: (-change.by_m, change.entity))[:CHANGES_MAX])


def _compare(was: Entity | None, entity: Entity) -> Change | None:
    if was is None:
        return Change(entity=entity.name, what="appeared")
    moved_m = round(math.dist(was.pose.position_m, entity.pose.position_m), 4)
    by_m = moved_m if moved_m > SEEN_MOVED_M else 0.0
    if was.status is not entity.status:
        released = was.status is Status.HELD
        return Change(entity=entity.name, what="released" if released else entity.status.value, by_m=by_m)
    return Change(entity=entity.name, what="moved", by_m=by_m) if by_m else None
