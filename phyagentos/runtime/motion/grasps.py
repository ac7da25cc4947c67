"""Grasps of an entity with a parallel gripper, from above wherever that is possible.

A box offers four yaws, which close on its faces; a round entity eight. Labels count the yaw from the object, so they
survive a nudge. Where something is beside the object, the fingers open only as wide as is needed. Where no upright
grasp fits, the hand tilts about its closing axis; then it closes on opposite edges; then on one solid of the entity
alone, as on the wall of a bowl or on the handle of a mug; then it lies and comes along its own axis, under a board;
at last, from where a handle opens to, across it, or to an edge that juts out. An object of several solids is closed on
where both pads meet it alike, near its weight; elsewhere only where nothing else is left.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain, product

import numpy as np

from phyagentos.geometry import make_matrix, rotate
from phyagentos.protocol.capabilities.targets import FINGERTIP_CLEAR_M, Gripper
from phyagentos.protocol.world.entity_geometry import compute_reach
from phyagentos.protocol.world.environment import Entity, ShapeKind
from phyagentos.protocol.world.mechanisms import compute_motion
from phyagentos.runtime.motion.approaches import ApproachCandidate, Screen, find_approaches
from phyagentos.runtime.motion.job import Job
from phyagentos.runtime.motion.kinematics import Kinematics
from phyagentos.runtime.motion.pad_contacts import PadContact, find_pad_contact
from phyagentos.runtime.motion.planning_scene import PlanningScene
from phyagentos.runtime.motion.poses import UP, find_way_out, move_pose, point_tool_down, tilt_tool
from phyagentos.runtime.motion.requests import Approach, Approaches, Array, FindGrasps, NoPlan
from phyagentos.runtime.motion.shapes import Box, compute_entity_box, compute_shape_boxes, is_round, settle

WIDTH_CLEARANCE_M = 0.006  # room for an error of the believed pose, both sides together
LEAST_CLEARANCE_M = 0.002  # of what is nearly as wide as the hand opens: it is taken so or not at all
NARROW_M = (0.02, 0.012)  # further open than the object is wide, where there is no room for more
TILTS_DEG = (20, -20, 40, -40)  # about the closing axis; the smaller ones first
SIDE_DEG = (65, -65)  # from the side, where nothing else is free
LYING_DEG = (80, -80, 65, -65)  # of a hand that comes along its own axis; it rises on the way back, with the object
HAND_HALF_M = 0.036  # of a lying hand, above what the object stands on
EDGE_DEPTH_M = 0.008  # of the tool centre point within an edge; the pads reach a centimetre further
BESIDE_M, FLAT_CLEAR_M = 0.004, 0.002  # that fingertips reach down beside a flat object, and keep from its support
BELOW_M = 0.001  # the foot of an object by its support, as believed
SHIFTS = (0.5, -0.5, 1.0, -1.0)  # along an object, as shares of the longest way
SHIFT_MAX_M = 0.025  # from the middle: its weight turns it between the pads
DEAD_ENDS_MAX = 6  # groups of grasps after which the object cannot be put down, until the first is taken
LEVER_M = 0.005  # further from the weight than the best grasp is poor
SHIFT_PAD_M = 0.012  # of the object that is left beside the middle of the pads
STRADDLE_M = 0.05  # over this last part of the way the fingers are beside the object
RIM_DEPTH_M = 0.006  # of the tool centre point under the edge of a single solid; its pads reach a centimetre further
SOLID_OPEN_M = 0.016  # further open than a single solid is wide: there is little room in a vessel
LEANS = (1.0, 0.5, 0.0)  # of the hand with a leaning wall: as it leans, by half, upright
SOLID_MAX_M = 0.03  # a thicker solid is no wall or handle
TURNED_COS = 0.3  # least, of the way that the hand points with straight down once the object is turned
UP_COS = 0.966  # 15 degrees: the side that is up by that much need not be brought up
ALONG_COS = 0.9  # of the closing axis with the direction that is asked for
FRONT_DEG = (0, 8, 16, 30, 50)  # below the level, of a hand that takes a handle from its front
OPENING_STEP = 0.01  # [m or rad] by which an object is opened to see where its handle goes
ALONG_SINE = 0.3  # of the closing axis with the way of a handle
LEVEL_SINE, DOWN_COS = 0.6, 0.7  # of the closing axis, and of the way down to a single solid


def find_grasps(
    request: FindGrasps,
    entity: Entity,
    kinematics: Kinematics,
    scene: PlanningScene,
    job: Job,
    place: Callable[[Approach], Approaches | NoPlan | None] = lambda _: None,
) -> Approaches | NoPlan:
    """Approaches to grasps of `entity`, the nearest first; if any, those from which `place` finds a way on."""
    gripper = scene.robot.profile.gripper
    entity = settle(entity, request.world.entities)
    make_way = partial(
        ApproachCandidate,
        hover_m=request.hover_m,
        tolerate=frozenset(product(scene.robot.jaws, (entity.name, *_find_supports(entity, request.world.entities)))),
        tolerate_m=STRADDLE_M,
    )
    turns = request.then is not None and request.then.up is not None
    is_whole = turns or len(entity.shapes) == 1  # what is turned is held across its middle
    ways, poor = _compute_ways(entity, gripper, make_way, whole=is_whole)
    corners: list[ApproachCandidate] = []
    if is_whole and not is_round(entity):
        corners, _ = _compute_ways(entity, gripper, make_way, whole=True, corners=True)
    solids = list(_iter_solid_ways(entity, gripper, make_way))
    last = chain(_iter_front_ways(request, entity, gripper, make_way), _iter_edge_ways(entity, gripper, make_way))
    screen = Screen(kinematics, request.q_rad, scene.robot.home_rad, request.seed)
    tried, dead, dead_ends = set[str](), set[str](), list[list[Approach]]()
    for batch in chain(_iter_batches(ways, corners, solids, last, entity), (poor,)):
        wanted = [way for way in batch if way.label not in {*request.avoid, *dead} and _is_wanted(way, entity, request)]
        tried.update(way.label for way in wanted)
        found = find_approaches(
            wanted, q_rad=request.q_rad, screen=screen, kinematics=kinematics, scene=scene, job=job, count=request.count
        )
        if found:
            leading, leads_on = _drop_dead_ends(found, place) if not request.moves else _keep_leading(found, place)
            if leading or (len(dead_ends) == DEAD_ENDS_MAX and not turns):
                return Approaches(
                    approaches=tuple(leading or dead_ends[0]), timing=job.timing, stages=job.stages, leads_on=leads_on
                )
            dead_ends.append(found)
            dead.update(approach.label for approach in found)
    if dead_ends and not turns:
        return Approaches(approaches=tuple(dead_ends[0]), timing=job.timing, stages=job.stages)
    if not ways and not solids and not poor:
        opens = f"the gripper opens ({gripper.max_width_m} m), less {1e3 * LEAST_CLEARANCE_M:.0f} mm of room"
        return job.fail("NOT_GRASPABLE", f"{entity.name} is wider than {opens}, and no edge that juts out is in reach.")
    avoided = f"; {', '.join(request.avoid)} avoided" if request.avoid else ""
    return job.fail("NO_IK", f"None of {len(tried)} ways to grasp {entity.name} works{avoided}.")


def _is_wanted(way: ApproachCandidate, entity: Entity, request: FindGrasps) -> bool:
    """Whether it closes in the requested direction, and the hand points down once another side of the object is up."""
    if request.then is not None and request.then.up is not None:
        up = np.array(rotate(entity.pose.quaternion_wxyz, request.then.up))
        if up[2] > UP_COS or up @ way.end[:3, 2] > -TURNED_COS:
            return False
    return request.along is None or abs(float(way.end[:3, 1] @ np.array(request.along))) > ALONG_COS


def _drop_dead_ends(
    found: list[Approach], place: Callable[[Approach], Approaches | NoPlan | None]
) -> tuple[list[Approach], bool]:
    """The approaches from the first that leads on, all where no grasp changes that; and whether a way on was found."""
    for index, approach in enumerate(found):
        if index and approach.label == found[index - 1].label:
            continue
        answer = place(approach)
        if not isinstance(answer, NoPlan) or answer.code != "NO_IK":
            return found[index:], isinstance(answer, Approaches)
    return [], False


def _keep_leading(
    found: list[Approach], place: Callable[[Approach], Approaches | NoPlan | None]
) -> tuple[list[Approach], bool]:
    """Those from which the hand can follow what it holds."""
    leading = [each for each in found if not isinstance(place(each), NoPlan)]
    return leading, bool(leading)


def _iter_batches(
    ways: list[ApproachCandidate],
    corners: list[ApproachCandidate],
    solids: list[ApproachCandidate],
    last: Iterator[list[ApproachCandidate]],
    entity: Entity,
) -> Iterator[list[ApproachCandidate]]:
    """What is tried together, the better first."""
    yield from _iter_tilted(ways, TILTS_DEG)
    for share in SHIFTS:
        yield from _iter_tilted([way for each in ways for way in _shift(each, entity, share)], TILTS_DEG)
    yield from _iter_tilted(corners, TILTS_DEG)
    for degrees in SIDE_DEG:
        yield _narrow(_tilt(ways, degrees), NARROW_M[0])
    yield solids
    yield from (_tilt(solids, degrees) for degrees in TILTS_DEG)
    yield [way for degrees in LYING_DEG for way in _lay(ways, entity, degrees)]
    yield from last


def _iter_tilted(ways: list[ApproachCandidate], tilts_deg: tuple[int, ...]) -> Iterator[list[ApproachCandidate]]:
    """Upright ones with the fingers as wide as they go, less wide, and tilted ones."""
    yield ways
    yield from (_narrow(ways, further_m) for further_m in NARROW_M)
    for degrees in tilts_deg:
        tilted = _tilt(ways, degrees)
        yield tilted
        yield _narrow(tilted, NARROW_M[0])


def _tilt(ways: list[ApproachCandidate], degrees: int) -> list[ApproachCandidate]:
    return [
        replace(way, label=f"{way.label}.tilt{degrees:+03d}", end=tilt_tool(way.end, np.radians(degrees)))
        for way in ways
    ]


def _lay(ways: list[ApproachCandidate], entity: Entity, degrees: int) -> Iterator[ApproachCandidate]:
    """The same with a level hand that comes along its own axis: under what covers the object."""
    box = compute_entity_box(entity)
    for way in ways:
        end = tilt_tool(way.end, np.radians(degrees))
        end[2, 3] = min(max(end[2, 3], box.bottom_m + HAND_HALF_M), box.top_m - RIM_DEPTH_M)
        yield replace(way, label=f"{way.label}.lying{degrees:+03d}", end=end, back=tuple((-end[:3, 2]).tolist()))


def _iter_edge_ways(
    entity: Entity, gripper: Gripper, make_way: Callable[..., ApproachCandidate]
) -> Iterator[list[ApproachCandidate]]:
    """Tool poses of a lying hand that closes from above and below, at each edge that may jut out over what bears it."""
    box = compute_entity_box(entity)
    vertical = int(np.argmax(np.abs(box.pose[2, :3])))
    up, thick_m = box.pose[:3, vertical], 2.0 * float(box.half_m[vertical])
    is_taken_so = entity.movable and abs(up[2]) > UP_COS and thick_m <= gripper.max_width_m - WIDTH_CLEARANCE_M
    for label, contact in _iter_contacts(entity, gripper, whole=True, corners=False) if is_taken_so else ():
        out = contact.end[:3, 0]
        edge_m = np.array(entity.pose.position_m) @ out + compute_reach(entity, tuple(out.tolist()))
        position = box.pose[:3, 3] + (edge_m - EDGE_DEPTH_M - box.pose[:3, 3] @ out) * out
        ends = {"edge": _make_pose(up, -out, position), "turned": _make_pose(-up, -out, position)}
        make = partial(make_way, openings_m=(thick_m, gripper.max_width_m))
        yield [make(label=f"{k}.{label}", end=end, back=find_way_out(end)) for k, end in ends.items()]


def _iter_front_ways(
    request: FindGrasps, entity: Entity, gripper: Gripper, make_way: Callable[..., ApproachCandidate]
) -> Iterator[list[ApproachCandidate]]:
    """Tool poses that take a handle from where it opens to, across one solid of it, at rising angles to the level."""
    whole = next((each for each in request.world.entities if each.name == entity.part_of and each.mechanism), None)
    if whole is None or whole.mechanism is None:
        return
    opens = compute_motion(whole.mechanism, OPENING_STEP)
    for pitch_deg in FRONT_DEG:
        ways = []
        for (index, box), closing, turned in product(enumerate(compute_shape_boxes(entity)), range(3), (1.0, -1.0)):
            at_m, y = box.pose[:3, 3], box.pose[:3, closing]
            out = opens[:3, :3] @ at_m + opens[:3, 3] - at_m
            out = out / np.linalg.norm(out)
            z = -np.cos(np.radians(pitch_deg)) * out - np.sin(np.radians(pitch_deg)) * UP
            if abs(out @ y) < ALONG_SINE and abs(out[2]) < ALONG_SINE:
                end = _make_pose(turned * y, z, at_m)
                width_m = 2.0 * float(np.abs(end[:3, 1] @ box.pose[:3, :3]) @ box.half_m)
                if width_m <= gripper.max_width_m - WIDTH_CLEARANCE_M:
                    opening_m = min(width_m + NARROW_M[0], gripper.max_width_m)
                    ways.append(
                        make_way(
                            label=f"front{pitch_deg}.solid{index}.{'xyz'[closing]}{turned:+.0f}",
                            end=end,
                            openings_m=(width_m, opening_m),
                            back=tuple((-z).tolist()),
                        )
                    )
        yield ways


def _shift(way: ApproachCandidate, entity: Entity, share: float) -> Iterator[ApproachCandidate]:
    """The same beside the middle, by a share of the longest way along the object; none where there is none."""
    box = compute_entity_box(entity)
    reach_m = float(np.abs(way.end[:3, 0] @ box.pose[:3, :3]) @ box.half_m)
    by_m = share * min(SHIFT_MAX_M, reach_m - SHIFT_PAD_M)
    if (
        abs(by_m) > SHIFT_PAD_M / 2
        and len(entity.shapes) == 1
        and entity.shapes[0].kind in (ShapeKind.BOX, ShapeKind.CAPSULE)
    ):
        yield replace(
            way, label=f"{way.label}.by{round(1e3 * by_m):+03d}", end=move_pose(way.end, by_m * way.end[:3, 0])
        )


def _narrow(ways: list[ApproachCandidate], further_m: float) -> list[ApproachCandidate]:
    """The same with the fingers so much further apart than the object is wide; none where that is no less."""
    return [
        replace(way, openings_m=(low_m, low_m + further_m))
        for way in ways
        for low_m, high_m in (way.openings_m,)
        if low_m + further_m < high_m
    ]


def _compute_ways(
    entity: Entity, gripper: Gripper, make_way: Callable[..., ApproachCandidate], *, whole: bool, corners: bool = False
) -> tuple[list[ApproachCandidate], list[ApproachCandidate]]:
    """Every tool pose that grasps an entity from above with the opening of the gripper, the good and the poor ones.

    `whole` closes on the middle of the box around it, whatever is there; `corners` closes on opposite edges of a box
    instead of its faces: the last resort.
    """
    widest_m = gripper.max_width_m
    contacts = dict(_iter_contacts(entity, gripper, whole=whole, corners=corners))
    is_wide = not corners and min(each.width_m for each in contacts.values()) > widest_m - WIDTH_CLEARANCE_M
    opening_m = widest_m - (LEAST_CLEARANCE_M if is_wide else WIDTH_CLEARANCE_M)
    contacts = {label: each for label, each in contacts.items() if each.width_m <= opening_m}
    most_m = min((each.lever_m for each in contacts.values()), default=0.0) + LEVER_M
    ways: tuple[list[ApproachCandidate], list[ApproachCandidate]] = ([], [])
    for label, each in contacts.items():
        way = make_way(
            label=label,
            end=each.end,
            openings_m=(each.width_m, widest_m),
            is_clear=not whole and np.isfinite(each.lever_m),
        )
        ways[each.lever_m > most_m].append(way)
    return ways


def _iter_contacts(entity: Entity, gripper: Gripper, *, whole: bool, corners: bool) -> Iterator[tuple[str, PadContact]]:
    """Where the pads meet it, by the label of the way; far from its weight for all that is known where not alike."""
    box = compute_entity_box(entity)
    vertical = int(np.argmax(np.abs(box.pose[2, :3])))
    first, second = (vertical + 1) % 3, (vertical + 2) % 3
    upright_round = is_round(entity) and vertical == 2
    yaw_rad = float(np.arctan2(box.pose[1, first], box.pose[0, first]))
    above_m = gripper.fingertip_m - _measure_lowering(box)
    tips_m = -np.inf if entity.part_of else box.bottom_m + above_m  # a handle stands on nothing
    height_m = max(box.pose[2, 3], box.top_m - gripper.palm_depth_m, tips_m)
    position = np.array((box.pose[0, 3], box.pose[1, 3], height_m))
    solids = [] if whole else compute_shape_boxes(entity)
    found = find_pad_contact(solids, point_tool_down(yaw_rad, position)) if solids and upright_round else None
    for degrees in range(45 if corners else 0, 360, 45 if upright_round else 90):
        half_m = box.half_m[second if degrees % 180 == 0 else first]  # at yaw 0 the tool's x axis lies along `first`
        if corners:
            half_m = np.hypot(box.half_m[first], box.half_m[second])
        turn_rad = np.radians(degrees)
        contact = PadContact(point_tool_down(yaw_rad + turn_rad, position), 2.0 * float(half_m))
        if solids:  # what is round about the vertical is alike from all sides, but the boxes around its solids are not
            found = found if upright_round else find_pad_contact(solids, contact.end)
            contact = found or replace(contact, lever_m=np.inf)
        if upright_round:
            contact = replace(contact, end=point_tool_down(turn_rad, contact.end[:3, 3]))
        yield f"yaw+{degrees:03d}", contact


def _measure_lowering(box: Box) -> float:
    """How much nearer than otherwise the fingertips come to what a flat object stands on [m]."""
    beside_m = box.top_m - box.bottom_m - FINGERTIP_CLEAR_M
    return min(max(BESIDE_M - beside_m, 0.0), FINGERTIP_CLEAR_M - FLAT_CLEAR_M)


def _find_supports(entity: Entity, others: tuple[Entity, ...]) -> list[str]:
    """Fixed entities that end below the foot of a flat object, which fingertips above it cannot touch."""
    box = compute_entity_box(entity)
    if not _measure_lowering(box):
        return []
    tops_m = ((each.name, compute_shape_boxes(each)) for each in others if not each.movable)
    return [name for name, boxes in tops_m if max(each.top_m for each in boxes) <= box.bottom_m + BELOW_M]


def _iter_solid_ways(
    entity: Entity, gripper: Gripper, make_way: Callable[..., ApproachCandidate]
) -> Iterator[ApproachCandidate]:
    """Tool poses that close on one thin solid of several, along its own axes; the fingers touch nothing else of it."""
    boxes = compute_shape_boxes(entity) if len(entity.shapes) > 1 else []
    low_m = min((box.bottom_m for box in boxes), default=0.0) + gripper.fingertip_m
    for index, box in enumerate(boxes):
        for closing in range(3):
            width_m = 2.0 * float(box.half_m[closing])
            y = box.pose[:3, closing]
            if width_m > SOLID_MAX_M or abs(y[2]) > LEVEL_SINE:
                continue
            for approach in ((closing + 1) % 3, (closing + 2) % 3):
                z = -np.sign(box.pose[2, approach]) * box.pose[:3, approach]
                if z[2] > -DOWN_COS:
                    continue
                up_m = max(0.0, float(box.half_m[approach]) - RIM_DEPTH_M)
                position = box.pose[:3, 3] - up_m * z
                position[2] = max(position[2], low_m)
                for (turned, sign), lean in product(enumerate((1.0, -1.0)), LEANS):
                    yield make_way(
                        label=f"solid{index}.{'xyz'[closing]}+{180 * turned:03d}.lean{lean:g}",
                        end=_make_pose(sign * y, lean * z - (1.0 - lean) * UP, position),
                        openings_m=(width_m, width_m + SOLID_OPEN_M),
                        is_clear=True,
                    )


def _make_pose(y: Array, z: Array, position_m: Array) -> Array:
    """(4, 4) of a closing axis as near to `y` (3,) as the approach direction `z` (3,) allows, and a position (3,)."""
    z = z / np.linalg.norm(z)
    y = y - (y @ z) * z
    y = y / np.linalg.norm(y)
    return make_matrix(np.column_stack((np.cross(y, z), y, z)), position_m)
