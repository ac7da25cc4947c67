"""Relations between objects, computed from one snapshot: what is on, inside, held, near, left of, open.

`inside`, `on`, `near`, `open` and `closed` are the predicates that verdicts use. `left_of` is meant along x of the
world, away from the robot's mount: towards greater y.
"""

import math
from collections.abc import Iterator, Mapping

from phyagentos.protocol.predicates.evaluation import evaluate
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.meaning import find_name, make_call
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.entity_geometry import compute_center
from phyagentos.protocol.world.environment import Entity, Environment, Relation
from phyagentos.protocol.world.truth import Truth

RELATIONS_MAX = 200  # places first, neighbours after them
NEIGHBOUR_M = 0.15  # farther apart, left and right mean nothing
ASIDE_M = 0.02  # less than this to the side is in front or behind


def compute_relations(
    environment: Environment, places: Mapping[str, list[Relation]] | None = None
) -> tuple[Relation, ...]:
    """Every relation that is true in a snapshot, those about places first: of `find_places` by entity, if found."""
    if places is None:
        places = {name: find_places(each, environment) for name, each in environment.entities.items()}
    found = [*_iter_places(environment, places), *_iter_joints(environment), *_iter_neighbours(environment)]
    return tuple(found[:RELATIONS_MAX])


def find_places(entity: Entity, environment: Environment) -> list[Relation]:
    """What an object is inside of, else what it is on; empty for what is fixed or held."""
    if entity.held_by or not entity.movable:
        return []
    others = [other for other in environment.entities.values() if other.name != entity.name]
    interiors = [*environment.regions, *(other.name for other in others if other.interior)]
    for meaning, places in ((Meaning.INSIDE, interiors), (Meaning.ON, [other.name for other in others])):
        found = [relation for place in places if (relation := _judge(environment, meaning, entity.name, place))]
        if found:
            return found
    return []


def list_inside(place: str, environment: Environment) -> list[str]:
    """Names of the objects that are inside of a place."""
    loose = [each.name for each in environment.entities.values() if each.movable and each.name != place]
    return [name for name in loose if _judge(environment, Meaning.INSIDE, name, place)]


def _iter_places(environment: Environment, places: Mapping[str, list[Relation]]) -> Iterator[Relation]:
    for name, entity in environment.entities.items():
        if entity.held_by:
            width_m = {each: state.gripper_width_m for each, state in environment.targets.items()}
            measured: dict[str, float | str | bool] = {}
            if entity.held_by in width_m:
                measured["gripper_width_m"] = round(width_m[entity.held_by], 5)
            yield _relate(find_name(Meaning.HOLDING), (entity.held_by, entity.name), measured, entity)
        yield from places[name]


def _iter_joints(environment: Environment) -> Iterator[Relation]:
    for entity in environment.entities.values():
        if entity.joint is not None:
            for meaning in (Meaning.OPEN, Meaning.CLOSED):
                if relation := _judge(environment, meaning, entity.name):
                    yield relation


def _iter_neighbours(environment: Environment) -> Iterator[Relation]:
    loose = [entity for entity in environment.entities.values() if entity.movable and entity.visible]
    for index, one in enumerate(loose):
        for other in loose[index + 1 :]:
            here, there = compute_center(one), compute_center(other)
            if math.dist(here, there) > NEIGHBOUR_M:
                continue
            if relation := _judge(environment, Meaning.NEAR, one.name, other.name):
                yield relation
            aside_m = here[1] - there[1]
            if abs(aside_m) > ASIDE_M:
                pair = (one, other) if aside_m > 0 else (other, one)
                measured: dict[str, float | str | bool] = {"aside_m": round(abs(aside_m), 4)}
                yield _relate("left_of", (pair[0].name, pair[1].name), measured, *pair)


def _judge(environment: Environment, meaning: Meaning, object: str, place: str = "") -> Relation | None:
    call = make_call(meaning, object, place)
    evaluation = evaluate(call, View(now=environment))
    if evaluation.truth is not Truth.TRUE:
        return None
    arguments = (object, place) if place else (object,)
    entities = [environment.entities[argument] for argument in arguments if argument in environment.entities]
    return _relate(call.name, arguments, dict(evaluation.measured), *entities)


def _relate(
    name: str, arguments: tuple[str, ...], measured: dict[str, float | str | bool], *entities: Entity
) -> Relation:
    movable = [entity for entity in entities if entity.movable] or list(entities)
    return Relation(
        name=name,
        arguments=arguments,
        measured=measured,
        observed_at_s=min((entity.observed_at_s for entity in movable), default=0.0),
        source=", ".join(dict.fromkeys(entity.source for entity in movable if entity.source)),
    )
