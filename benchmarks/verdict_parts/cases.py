"""What can go wrong, and what can go right: each class is a change of a recorded world, drawn anew for every case.

The controller's report of a case is that of the recorded session: what is changed here happened after its last check,
unseen by it. The only exception is a session that really failed and whose objective came about nevertheless.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from benchmarks.verdict_parts.worlds import OFF_TABLE_M, Change, Rng, World

ON_TOP_M = 0.002  # things are let go this far above what they fall on


class Lie(StrEnum):
    """What the sensors do."""

    NONE = "none"
    """They show the world."""
    HIDDEN = "hidden"
    """The thing cannot be seen; it is believed where it was."""
    STALE = "stale"
    """What they show, and say, is old."""
    FROZEN = "frozen"
    """They repeat an old picture with a new stamp."""
    SILENT = "silent"
    """They have said nothing since less than a second ago."""
    BLIND = "blind"
    """They have said nothing since the session began."""
    COVERED = "covered"
    """They show a world without the thing, and always did: it is under a cover."""
    MOVING = "moving"
    """They show one moment of a motion; there is no time for another look."""
    EARLIER = "earlier"
    """They showed nothing in the session before this one, and it happened then; its condition is carried on."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One class of cases.

    Attributes:
        name: As the table shows it.
        change: What is done to the world.
        lie: What the sensors do; they show the success before it when they lie.
        of_failed: Whether it begins from sessions that failed.
    """

    name: str
    change: Change
    lie: Lie = Lie.NONE
    of_failed: bool = False


def put_right(world: World, rng: Rng) -> None:
    """What the session should have brought about, somewhere else within what is allowed."""
    match world.recorded.job.name:
        case "home" | "inspect" | "survey" | "strangers":
            _nudge_all(world, rng, 0.006)
        case "stand":
            spot = np.array([*world.find_spot(rng), world.find_half_height("blue_block") + ON_TOP_M])
            world.put("blue_block", spot, float(rng.uniform(-np.pi, np.pi)))
            world.settle()
        case "pick":
            world.settle(float(rng.uniform(0.0, 0.4)))
        case "pick_and_place" | "place" | "twins":
            _open(world)
            half = _find_interior(world)[1]
            side = float(world.find_half_height(world.object))
            offset = rng.uniform(-1.0, 1.0, 2) * (half[:2] - 1.45 * side)
            _drop_into(world, offset, float(rng.uniform(-np.pi, np.pi)))
        case "push":
            _place_near(world, rng, 0.0, 0.04)
        case "stack" | "stack_round" | "stack_frame":
            _drop_on(world, world.destination, rng.uniform(-0.014, 0.014, 2), float(rng.uniform(-np.pi, np.pi)))
        case "carry_level":
            _open(world)
            _drop_on(world, world.destination, rng.uniform(-0.02, 0.02, 2))
        case "close_drawer":
            world.set_opening("drawer", float(rng.uniform(0.0, 0.07)))
            world.settle(0.2)


def close_on_air(world: World, rng: Rng) -> None:
    """The fingers closed beside the thing; it stands where it stood."""
    start = world.find_initial(world.object)
    if world.recorded.job.name == "close_drawer":
        world.set_opening("drawer", float(rng.uniform(0.5, 0.95)))
    else:
        world.set_fingers(0.0)
        yaw = float(2 * np.arctan2(start[6], start[3]))
        world.put(world.object, start[:3] + np.array([*rng.uniform(-0.006, 0.006, 2), ON_TOP_M]), yaw)
    world.settle()


def slip_late(world: World, rng: Rng) -> None:
    """It left the fingers after the last look at them, and fell."""
    if world.recorded.job.name == "pick":
        world.set_fingers(0.078)
        world.settle(0.4)
        world.set_fingers(0.0)
    else:
        _open(world)
        height = world.find_half_height(world.object) + float(rng.uniform(0.005, 0.08))
        world.put(world.object, np.array([*world.find_spot(rng), height]), float(rng.uniform(-3, 3)))
    world.settle(0.8)


def take_wrong(world: World, rng: Rng) -> None:
    """Another thing is where this one should be; this one stands where it stood."""
    other = _choose_other(world, rng)
    start = world.find_initial(world.object)
    world.exchange(world.object, other)
    if world.recorded.job.name != "pick":
        world.put(world.object, start[:3] + np.array([0.0, 0.0, ON_TOP_M]))
    world.settle()


def exchange(world: World, rng: Rng) -> None:
    """Somebody exchanged two things afterwards."""
    world.exchange(world.object, _choose_other(world, rng))
    world.settle()


def topple(world: World, rng: Rng) -> None:
    """It is where it should be, and lies on its side."""
    _open(world)
    center = world.physics.data.body(world.destination).xpos.copy()
    shift = rng.uniform(-0.01, 0.01, 2)
    world.put(world.object, center + np.array([*shift, 0.034]), float(rng.uniform(-np.pi, np.pi)), np.pi / 2)
    world.settle(1.0)


def leave_on_rim(world: World, rng: Rng) -> None:
    """It was let go over an edge of where it should be."""
    _open(world)
    side = world.find_half_height(world.object)
    if world.recorded.job.name in {"stack", "stack_frame", "carry_level"}:
        reach = 0.05 if world.recorded.job.name == "carry_level" else 0.025
        along = float(rng.uniform(-0.5, 0.5)) * reach
        edge = (reach + float(rng.uniform(-0.004, 0.02))) * rng.choice([-1.0, 1.0])
        _drop_on(world, world.destination, np.array([edge, along])[:: int(rng.choice([-1, 1]))])
        return
    center, half = _find_interior(world)
    axis, sign = int(rng.integers(2)), float(rng.choice([-1.0, 1.0]))
    offset = np.zeros(2)
    offset[axis] = sign * (half[axis] + float(rng.uniform(-0.004, 0.006)))
    offset[1 - axis] = float(rng.uniform(-0.7, 0.7)) * half[1 - axis]
    rim_m = center[2] + half[2] + side + ON_TOP_M
    _put_at(world, offset, rim_m, float(rng.choice([0.0, np.pi / 4, rng.uniform(-np.pi, np.pi)])))
    world.settle(1.0)


def stack_instead(world: World, rng: Rng) -> None:
    """It stands on another thing, not in, or on, what it should."""
    other = _choose_other(world, rng)
    _open(world)
    if world.recorded.job.name == "stack":
        _drop_on(world, other, rng.uniform(-0.006, 0.006, 2))
        return
    center, _ = _find_interior(world)
    low = world.find_half_height(other)
    position = _to_world(world, np.array([*rng.uniform(-0.02, 0.02, 2), 0.0]))
    floor = world.physics.data.body(world.destination).xpos[2] + 0.005
    world.put(other, np.array([*position[:2], floor + low + ON_TOP_M]))
    on_top = floor + 2 * low + world.find_half_height(world.object) + 2 * ON_TOP_M
    world.put(world.object, np.array([*(position[:2] + rng.uniform(-0.005, 0.005, 2)), on_top]))
    world.settle(1.0)
    del center


def move_back(world: World, rng: Rng) -> None:
    """It was put right, and somebody put it back."""
    if world.recorded.job.name == "close_drawer":
        world.set_opening("drawer", float(rng.uniform(0.4, 0.95)))
        world.settle(0.3)
        return
    _open(world)
    start = world.find_initial(world.object)[:3]
    world.put(world.object, start + np.array([*rng.uniform(-0.03, 0.03, 2), ON_TOP_M]), float(rng.uniform(-3, 3)))
    world.settle()


def take_away(world: World, rng: Rng) -> None:
    """It is where nobody can see it."""
    _open(world)
    x, y, z = OFF_TABLE_M
    world.put(world.object, np.array([x + rng.uniform(-0.1, 0.1), y + rng.uniform(-0.1, 0.1), z]))
    world.settle(0.5)


def leave_drawer_open(world: World, rng: Rng) -> None:
    """The drawer did not go all the way."""
    world.set_opening("drawer", float(rng.uniform(0.125, 0.3)))
    world.settle(0.2)


def leave_short(world: World, rng: Rng) -> None:
    """It stands near where it should, and not near enough."""
    _place_near(world, rng, 0.054, 0.09)


def disturb(world: World, rng: Rng) -> None:
    """Something that should have been left alone was not."""
    if world.recorded.job.name == "stack":
        world.put("red_block", np.array([*world.find_spot(rng), 0.027]))
    else:
        name = _find_guarded(world, rng)
        pose = world.find_initial(name)
        angle, way = float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(0.021, 0.05))
        shift = np.array([way * np.cos(angle), way * np.sin(angle), 0.001])
        world.put(name, pose[:3] + shift, float(2 * np.arctan2(pose[6], pose[3])))
    world.settle()


def leave_sliding(world: World, rng: Rng) -> None:
    """It is where it should be, and on its way elsewhere."""
    angle, speed_m_s = float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(0.15, 0.4))
    world.push(world.object, np.array([speed_m_s * np.cos(angle), speed_m_s * np.sin(angle), 0.0]))


def leave_beside_round(world: World, rng: Rng) -> None:
    """It stands over the corner of the box around a round support."""
    corner = np.pi / 4 + np.pi / 2 * int(rng.integers(4)) + float(rng.uniform(-0.15, 0.15))
    reach_m = 0.05 + float(rng.uniform(0.009, 0.018))
    _drop_on(world, world.destination, reach_m * np.array([np.cos(corner), np.sin(corner)]), corner)


def put_on_plate(world: World, rng: Rng) -> None:
    """A thin plate is between it and what it should stand on."""
    yaw = float(rng.uniform(-np.pi, np.pi))
    _drop_on(world, world.destination, rng.uniform(-0.01, 0.01, 2), yaw, "plate")
    _drop_on(world, "plate", rng.uniform(-0.008, 0.008, 2), yaw)


def hide_in_tray(world: World, rng: Rng) -> None:
    """It is in the tray that should be empty."""
    tray = world.recorded.job.accept[0].split()[-1].rstrip(")")
    position = world.physics.data.body(tray).xpos + np.array([*rng.uniform(-0.02, 0.02, 2), 0.03])
    world.put(world.object, position, float(rng.uniform(-3, 3)))
    world.settle()


def lean_on_edge(world: World, rng: Rng) -> None:
    """It leans on the edge of a thin plate, by ten degrees."""
    yaw = float(rng.uniform(-np.pi, np.pi))
    plate, high = np.array([*world.find_spot(rng), 0.004]), world.find_half_height("blue_block")
    past = 0.03 + float(rng.uniform(0.002, 0.012))
    world.put("plate", plate, yaw)
    world.put("blue_block", plate + np.array([past * np.cos(yaw), past * np.sin(yaw), 0.006 + high]), yaw)
    world.settle(1.0)


_PLACING = ("pick_and_place", "place")
_MOVING = (*_PLACING, "stack")
_AIR = Kind("closed on air", close_on_air)
_SLIP = Kind("slipped late", slip_late)
_WRONG = Kind("wrong object", take_wrong)
_SWAPPED = Kind("object swapped", exchange)
_RIM = Kind("on the rim", leave_on_rim)
_TOP = Kind("stacked instead of inside", stack_instead)
_BACK = Kind("moved back afterwards", move_back)
_HIDDEN = Kind("occluded", take_away, Lie.HIDDEN)
_STALE = Kind("sensor stale", move_back, Lie.STALE)
_FROZEN = Kind("picture frozen", move_back, Lie.FROZEN)
_SILENT = Kind("cameras silent", move_back, Lie.SILENT)
_SLIDING = Kind("still sliding", leave_sliding, Lie.MOVING)
_ELSE = Kind("something else moved", disturb)
FAILURES: Mapping[str, tuple[Kind, ...]] = {
    "home": (_ELSE, Kind("sensor stale", disturb, Lie.STALE), Kind("picture frozen", disturb, Lie.FROZEN)),
    "inspect": (
        _ELSE, _HIDDEN, Kind("sensor stale", take_away, Lie.STALE), Kind("picture frozen", take_away, Lie.FROZEN),
    ),
    "pick": (
        _AIR, _SLIP, _WRONG, _SWAPPED, _BACK, Kind("wrong object unseen", take_wrong, Lie.BLIND),
        Kind("sensor stale", slip_late, Lie.STALE),
        Kind("picture frozen", slip_late, Lie.FROZEN),
    ),
    "stand": (Kind("leaning a little", lean_on_edge),),
    "survey": (Kind("under a cover", hide_in_tray, Lie.COVERED), Kind("in the tray", hide_in_tray)),
    "pick_and_place": (
        _AIR, _SLIP, _WRONG, _SWAPPED, _RIM, _TOP, _BACK, _HIDDEN, _STALE, _FROZEN, _ELSE, _SILENT, _SLIDING,
        Kind("moved before the replan", disturb, Lie.EARLIER),
    ),
    "twins": (Kind("twin taken", take_wrong), Kind("twins exchanged", exchange)),
    "place": (_SLIP, _WRONG, _SWAPPED, _TOP, _BACK, _HIDDEN, _STALE, _FROZEN, _SILENT, _SLIDING),
    "push": (
        _AIR, Kind("pushed short", leave_short), _SWAPPED, _BACK, _HIDDEN, _STALE, _FROZEN, _SILENT, _SLIDING,
    ),
    "stack": (_AIR, _SLIP, _WRONG, _SWAPPED, _RIM, _TOP, _BACK, _HIDDEN, _STALE, _FROZEN, _ELSE, _SILENT, _SLIDING),
    "stack_round": (
        Kind("beside a round support", leave_beside_round), Kind("through a plate", put_on_plate), _SILENT, _SLIDING,
    ),
    "stack_frame": (Kind("beside a step placed in a frame", leave_on_rim), _SLIP, _BACK, _SILENT, _SLIDING),
    "strangers": (Kind("unnamed in the tray", hide_in_tray),),
    "carry_level": (
        _AIR, _SLIP, Kind("right place but fallen", topple), _RIM, _BACK, _HIDDEN, _STALE, _FROZEN,
    ),
    "close_drawer": (_AIR, _BACK, Kind("drawer nearly closed", leave_drawer_open), _STALE, _FROZEN),
}  # fmt: skip
SUCCESS = Kind("done", put_right)
UNPLANNED = Kind("unplanned success of a failed primitive", put_right, of_failed=True)


def _choose_other(world: World, rng: Rng) -> str:
    """Another thing of the same size."""
    return str(rng.choice([name for name in world.others if name.split("_")[-1] == world.object.split("_")[-1]]))


def _find_guarded(world: World, rng: Rng) -> str:
    """A thing that the acceptance says must not have moved."""
    named = [text for text in world.recorded.job.accept if text.startswith("not moved(") and "*" not in text]
    return named[0].removeprefix("not moved(").rstrip(")") if named else str(rng.choice(world.others))


def _open(world: World) -> None:
    world.set_fingers(0.078)


def _find_interior(world: World) -> tuple[np.ndarray, np.ndarray]:
    entity = next(each for each in world.physics.scene.entities if each.name == world.destination)
    assert entity.interior is not None
    return np.array(entity.interior.center_m), np.array(entity.interior.half_m)


def _to_world(world: World, local: np.ndarray) -> np.ndarray:
    seen = world.physics.data.body(world.destination)
    return np.asarray(seen.xmat.reshape(3, 3) @ local + seen.xpos)


def _put_at(world: World, offset: np.ndarray, height_m: float, yaw: float) -> None:
    place = _to_world(world, np.array([*offset, height_m]))
    world.put(world.object, place, yaw)


def _drop_into(world: World, offset: np.ndarray, yaw: float) -> None:
    center, half = _find_interior(world)
    floor = center[2] - half[2]
    _put_at(world, offset, floor + world.find_half_height(world.object) + ON_TOP_M, yaw)
    world.settle()


def _drop_on(world: World, support: str, offset: np.ndarray, yaw: float = 0.0, thing: str = "") -> None:
    _open(world)
    seen = world.physics.data.body(support).xpos
    entity = next(each for each in world.physics.scene.entities if each.name == support)
    top = seen[2] + max(shape.pose.position_m[2] + shape.size_m[-1] for shape in entity.shapes)
    height = top + world.find_half_height(thing or world.object) + ON_TOP_M
    world.put(thing or world.object, np.array([*(seen[:2] + offset), height]), yaw)
    world.settle(1.0)


def _place_near(world: World, rng: Rng, least_m: float, most_m: float) -> None:
    point = np.array(world.recorded.job.given["to"])
    angle, way = float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(least_m, most_m))
    shift = np.array([way * np.cos(angle), way * np.sin(angle)])
    height = world.find_half_height(world.object) + ON_TOP_M
    world.put(world.object, np.array([*(point[:2] + shift), height]), float(rng.uniform(-3, 3)))
    world.settle()


def _nudge_all(world: World, rng: Rng, most_m: float) -> None:
    for name in world.others:
        pose = world.find_initial(name)
        shift = np.array([*rng.uniform(-most_m, most_m, 2), 0.0005])
        world.put(name, pose[:3] + shift, float(2 * np.arctan2(pose[6], pose[3])))
    world.settle(0.3)
