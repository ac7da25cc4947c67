"""A goal as a picture: the scene as it begins, what the goal speaks of, and where each object is to be."""

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.planned import Step
from phyagentos.geometry import Vector, to_parent
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.world.entity_geometry import AXES, compute_extent, compute_lowest
from phyagentos.protocol.world.environment import Environment, Pose

if TYPE_CHECKING:
    from phyagentos.pictures.labelled import Move

_ABOVE_M = 0.002  # of a floor, so that both are seen
_NEXT_M = 0.07  # from one of several objects on a place to the next


def write_preview(
    goal: WantedGoal, steps: Sequence[Step], world: Environment, library: Library, seed: int, to: Path
) -> None:
    """Write the picture of a goal and its plan; raises as `draw_scene`."""
    from phyagentos.assembly.scene_picture import draw_scene
    from phyagentos.pictures.labelled import Drawing

    texts = [*goal.accept, *goal.constraints, *(text for step in goal.steps for text in step)]
    texts += [str(value) for step in steps for value in step.parameters.values()]
    words = {word for text in texts for word in re.findall(r"\w+", text)}
    lines = [f"goal: {goal.objective}", *(f"{number}  {_describe(step)}" for number, step in enumerate(steps, 1))]
    lines += [f"always: {', '.join(goal.constraints)}"] if goal.constraints else []
    drawing = Drawing(names=sorted(words & world.entities.keys()), moves=[*_iter_moves(steps, world)], lines=lines)
    draw_scene(library, world.scene, goal.targets.values(), seed, drawing, to)


def _describe(step: Step) -> str:
    return f"{step.skill}({', '.join(f'{key}={value}' for key, value in step.parameters.items())})"


def _iter_moves(steps: Sequence[Step], world: Environment) -> Iterator["Move"]:
    """Each session that takes a movable object to a place, with a place for it there that no other object has."""
    from phyagentos.pictures.labelled import Move

    filled, pairs = Counter[str](), [_find_move(step, world) for step in steps]
    room = Counter(place for _, place in filter(None, pairs) if isinstance(place, str))
    for number, pair in enumerate(pairs, 1):
        if pair is None:
            continue
        name, place = pair
        if isinstance(place, str):
            to_m = _find_spot(world, name, place, filled[place], room[place])
            filled[place] += 1
        else:
            to_m = place
        moved = replace(world.entities[name], pose=Pose(to_m, world.entities[name].pose.quaternion_wxyz))
        world = replace(world, entities={**world.entities, name: moved})
        yield Move(name, to_m, number)


def _find_move(step: Step, world: Environment) -> tuple[str, str | Vector] | None:
    """The object that a session moves, and the object, region or point that it takes it to."""
    values = [value for value in step.parameters.values() if isinstance(value, str | list | tuple)]
    names = [value for value in values if isinstance(value, str) and value in world.entities]
    name = next((each for each in names if world.entities[each].movable), None)
    for value in values:
        if isinstance(value, str) and value != name and value in {*world.entities, *world.regions}:
            return (name, value) if name is not None else None
        if name is not None and not isinstance(value, str) and len(value) == 3:
            x, y, z = map(float, value)
            return name, (x, y, z)
    return None


def _find_spot(world: Environment, name: str, place: str, index: int, count: int) -> Vector:
    """Where the origin of an object is (3,), with the object at the `index`-th of `count` places in or on another."""
    entity, holder, region = world.entities[name], world.entities.get(place), world.regions.get(place)
    if region is not None:
        pose, center, half = region.pose, (0.0, 0.0, 0.0), region.half_m
    elif holder is not None and holder.interior is not None:
        pose, center, half = holder.pose, holder.interior.center_m, holder.interior.half_m
    elif holder is not None:
        (left, right), (back, front), (_, high) = (compute_extent(holder, axis) for axis in AXES)
        pose, center = holder.pose, ((left + right) / 2, (back + front) / 2, high)
        half = ((right - left) / 2, (front - back) / 2, 0.0)
    columns = max(1, min(count, int(2 * max(half[:2]) / _NEXT_M)))
    rows = math.ceil(count / columns)
    offsets = [(index % columns - (columns - 1) / 2) * _NEXT_M, (index // columns - (rows - 1) / 2) * _NEXT_M]
    along, across = offsets if half[0] >= half[1] else offsets[::-1]
    x, y, floor_m = to_parent(pose, (center[0] + along, center[1] + across, center[2] - half[2]))
    return (x, y, floor_m + _ABOVE_M + entity.pose.position_m[2] - compute_lowest(entity))
