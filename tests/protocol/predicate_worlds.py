"""Synthetic worlds for the tests of predicates."""

import math
from typing import Any

from phyagentos.protocol.predicates.predicate import Evaluation, View, parse_predicate
from phyagentos.protocol.world.environment import Entity, Environment, Interior, Pose, Shape, ShapeKind
from phyagentos.protocol.world.truth import Truth

HALF_TURN_ABOUT_X = (0.0, 1.0, 0.0, 0.0)
QUARTER_TURN_ABOUT_X = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
EIGHTH_TURN_ABOUT_Z = (math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8))


def cube(name: str, x: float = 0.0, y: float = 0.0, z: float = 0.02, **more: Any) -> Entity:
    facts: dict[str, Any] = {"kind": "cube", "pose": Pose((x, y, z)), "observed_at_s": 10.0}
    facts["shapes"] = (Shape(ShapeKind.BOX, (0.02, 0.02, 0.02)),)
    return Entity(name=name, **(facts | more))


def tray(name: str = "tray", x: float = 0.5, y: float = 0.0, **more: Any) -> Entity:
    floor = Shape(ShapeKind.BOX, (0.1, 0.06, 0.005), Pose((0, 0, 0.005)))
    facts: dict[str, Any] = {"kind": "tray", "pose": Pose((x, y, 0.0)), "shapes": (floor,), "movable": False}
    facts["interior"] = Interior((0.0, 0.0, 0.03), (0.09, 0.05, 0.02))
    return Entity(name=name, **(facts | more))


def world(*objects: Entity, **more: Any) -> Environment:
    facts = {"time_s": 10.0, "scene": "s", "episode": "e", "revision": 1, "sensing": "truth"}
    return Environment(**(facts | {"entities": {item.name: item for item in objects}} | more))


def value(text: str, now: Environment, initial: Environment | None = None, target: str | None = "arm") -> Evaluation:
    return parse_predicate(text).evaluate(View(now=now, initial=initial, target=target))


def truth(text: str, now: Environment, initial: Environment | None = None) -> Truth:
    return value(text, now, initial).truth
