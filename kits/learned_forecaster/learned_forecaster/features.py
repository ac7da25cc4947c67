"""A session and the estimate that it begins in, as numbers: what the learned forecaster goes by.

A feature with `=` in its name is a category, 1 where it applies and absent elsewhere; all others are quantities, absent
where they have no meaning (the size of an object, in a session about none).
"""

import math
from collections.abc import Iterator

from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Entity, Environment

Point = tuple[float, float, float]
NEAR_M = 0.12  # an object so close to another one is in its way


def describe_case(session: Session, environment: Environment) -> dict[str, float]:
    """Features by name; lengths in metres, in the frame of the world."""
    found = {f"skill={session.skill}": 1.0, f"target={session.target}": 1.0, f"scene={session.scene.name}": 1.0}
    found |= {
        "attempt": float(session.attempt),
        "speed": session.strategy.speed,
        "avoided": float(len(session.strategy.avoid_grasps) + len(session.strategy.avoid_sites)),
        "conditions": float(len(session.accept) + len(session.hold)),
    }
    name = environment.find_movable(session.parameters.values())
    item = environment.entities[name] if name is not None else None
    target = environment.targets.get(session.target)
    if item is not None:
        found |= dict(_describe_object(item, environment))
        if target is not None:
            found["hand_to_thing_m"] = math.dist(target.tcp.position_m, item.pose.position_m)
    places = (each for each in session.parameters.values() if each != name)
    place = next((each for each in places if _find_place(environment, each)), None)
    point = _find_place(environment, place)
    if point is not None:
        entity = environment.entities.get(str(place))
        found[f"place={entity.kind if entity else 'region'}"] = 1.0
        found["place_crowd"] = float(len(_find_near(point, environment, {name, str(place)})))
        if item is not None:
            found["thing_to_place_m"] = math.dist(item.pose.position_m, point)
        if target is not None:
            found["hand_to_place_m"] = math.dist(target.tcp.position_m, point)
    return found


def _describe_object(item: Entity, environment: Environment) -> Iterator[tuple[str, float]]:
    yield f"kind={item.kind}", 1.0
    if sizes_m := [size_m for shape in item.shapes for size_m in shape.size_m]:
        yield from (("largest_m", max(sizes_m)), ("smallest_m", min(sizes_m)))
    _, x, y, _ = item.pose.quaternion_wxyz
    yield "height_m", item.pose.position_m[2]
    yield "tilt", math.hypot(x, y)  # of its z axis to the vertical: sin(angle / 2)
    yield "position_std_m", item.position_std_m
    near = _find_near(item.pose.position_m, environment, {item.name})
    yield "crowd", float(len(near))
    yield "load", float(sum(each.pose.position_m[2] > item.pose.position_m[2] for each in near))


def _find_place(environment: Environment, name: object) -> Point | None:
    found = environment.entities.get(str(name)) or environment.regions.get(str(name))
    return found.pose.position_m if found is not None else None


def _find_near(point: Point, environment: Environment, besides: set[str | None]) -> list[Entity]:
    objects = (each for each in environment.entities.values() if each.movable and each.name not in besides)
    return [each for each in objects if math.dist(each.pose.position_m, point) < NEAR_M]
