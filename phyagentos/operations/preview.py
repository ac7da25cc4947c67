"""A goal as a picture: the scene as it begins, what the goal speaks of, and where each object is to be."""

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.planning.answers import Step
from phyagentos.geometry import UP, Pose, Vector, to_parent
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.predicates.library import get_place
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.entity_geometry import AXES, compute_lowest, compute_reach
from phyagentos.protocol.world.environment import Entity, Environment

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

    called = [
        f"{each.skill}({', '.join(f'{key}={value}' for key, value in each.parameters.items())})" for each in steps
    ]
    wanted = [*goal.accept, *goal.constraints, *(text for step in goal.steps for text in step)]
    words = {word for text in (*wanted, *called) for word in re.findall(r"\w+", text)}
    lines = [f"goal: {goal.objective}", *(f"{number} {each}" for number, each in enumerate(called, 1))]
    lines += [f"always: {', '.join(goal.constraints)}"] if goal.constraints else []
    drawing = Drawing(names=sorted(words & world.entities.keys()), moves=[*_iter_moves(steps, world)], lines=lines)
    draw_scene(library, world.scene, goal.targets.values(), seed, drawing, to)


def _iter_moves(steps: Sequence[Step], world: Environment) -> Iterator["Move"]:
    """Each session that takes a movable object to a place, with a spot there that no other object has."""
    from phyagentos.pictures.labelled import Move

    pairs = [_find_move(step, world) for step in steps]
    places, filled = [pair[1] for pair in pairs if pair is not None], Counter[str | Vector]()
    for number, (name, place) in ((number, pair) for number, pair in enumerate(pairs, 1) if pair is not None):
        entity, index = world.entities[name], filled[place]
        to_m = _find_spot(world, entity, place, index, places.count(place)) if isinstance(place, str) else place
        filled[place] += 1
        moved = replace(entity, pose=Pose(to_m, entity.pose.quaternion_wxyz))
        world = replace(world, entities={**world.entities, name: moved})
        yield Move(name, entity.pose.position_m, to_m, number)


def _find_move(step: Step, world: Environment) -> tuple[str, str | Vector] | None:
    """The object that a session moves, and the object, region or point that it takes it to."""
    values = list(step.parameters.values())
    named = [each for each in values if isinstance(each, str) and each in {*world.entities, *world.regions}]
    name = next((each for each in named if each in world.entities and world.entities[each].movable), None)
    points: list[str | Vector] = [
        (x, y, z) for each in values if isinstance(each, list | tuple) and len(each) == 3 for x, y, z in [each]
    ]
    places = [*(each for each in named if each != name), *points]
    return (name, places[0]) if name is not None and places else None


def _find_spot(world: Environment, entity: Entity, name: str, index: int, count: int) -> Vector:
    """Where the origin of an object is (3,), with the object at the `index`-th of `count` spots in or on another."""
    place, holder = get_place(View(now=world), name, math.inf), world.entities.get(name)
    x, y, z = place.pose.position_m
    half_m, floor_m = place.half_m[:2], z - place.half_m[2]
    if holder is not None and holder.interior is None:
        half_m = (compute_reach(holder, AXES[0]), compute_reach(holder, AXES[1]))
        floor_m = holder.pose.position_m[2] + compute_reach(holder, UP)
    columns = max(1, min(count, int(2 * max(half_m) / _NEXT_M)))
    aside = _NEXT_M * (index % columns - (columns - 1) / 2)
    ahead = _NEXT_M * (index // columns - (math.ceil(count / columns) - 1) / 2)
    offset = (aside, ahead, 0.0) if half_m[0] >= half_m[1] else (ahead, aside, 0.0)
    x, y, _ = to_parent(place.pose, offset)
    return (x, y, floor_m + _ABOVE_M + entity.pose.position_m[2] - compute_lowest(entity))
