"""Small worlds and contracts, of which a test names only the fields that it is about."""

from typing import Any

from phyagentos.geometry import Vector
from phyagentos.protocol.sessions.session import Scene, Session
from phyagentos.protocol.world.environment import Entity, Environment, Interior, Pose, Shape, ShapeKind


def make_contract(**facts: Any) -> Session:
    """A session; any field can be given, the others mean nothing."""
    others: dict[str, Any] = {
        "id": "g.a",
        "goal": "g",
        "node": "a",
        "objective": "o",
        "skill": "pick_and_place",
        "target": "panda",
        "parameters": {},
        "accept": (),
        "scene": Scene(name="s", seed=0, episode="e"),
        "seed": 0,
    }
    return Session(**(others | facts))


def make_cube(name: str = "red_cube", position_m: Vector = (0.5, 0.0, 0.02), **changes: Any) -> Entity:
    """A cube with sides of 4 cm; any field of an entity can be given."""
    shape = Shape(kind=ShapeKind.BOX, size_m=(0.02, 0.02, 0.02))
    facts: dict[str, Any] = {"name": name, "kind": "cube", "pose": Pose(position_m), "shapes": (shape,)}
    return Entity(**(facts | changes))


def make_tray(name: str = "red_tray", position_m: Vector = (0.5, 0.3, 0.0), **changes: Any) -> Entity:
    """A tray that stands fast, 18 by 14 cm inside and 5 cm deep."""
    interior = Interior((0.0, 0.0, 0.035), (0.09, 0.07, 0.025))
    facts: dict[str, Any] = {"name": name, "kind": "tray", "pose": Pose(position_m), "interior": interior}
    return Entity(**(facts | {"movable": False} | changes))


def make_world(*entities: Entity, **facts: Any) -> Environment:
    """A snapshot that shows these entities as they truly are; any field can be given."""
    others: dict[str, Any] = {"time_s": 1.0, "scene": "s", "episode": "e", "revision": 1, "sensing": "truth"}
    return Environment(**(others | facts), entities={each.name: each for each in entities})
