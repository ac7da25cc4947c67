"""The world as a scene begins with a seed, before any process runs: what plans are made for ahead of a run."""

from collections.abc import Iterable, Mapping

import msgspec

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import name_placed, read_placed
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.world.environment import Contents, Entity, Environment
from phyagentos.protocol.world.scenes import Body


def draw_start(library: Library, scene: str, targets: Iterable[str], seed: int) -> Environment:
    """Objects and regions at their start, as the simulator would place them for these targets, known exactly.

    Raises:
        DefinitionError: The scene is not there, or invalid.
        ExecutionError: `SCENE_INVALID`.
    """
    from phyagentos.runtime.models.scene import draw_bodies, read_regions

    known = [name for name in targets if name in library.names_of_targets()]
    scene = name_placed(scene, [read_target(library.get_target(name)) for name in known])
    spec = read_placed(library, scene)
    placed = draw_bodies(spec, seed)
    return Environment(
        time_s=0.0,
        scene=scene,
        episode="",
        revision=0,
        sensing="truth",
        entities={item.name: _fill(item.as_entity(), spec.bodies) for item in placed},
        regions={region.name: region for region in read_regions(spec, placed)},
    )


def _fill(entity: Entity, bodies: Mapping[str, Body]) -> Entity:
    """The entity with the number of balls that the scene fills it with, in a scene that has any."""
    if entity.interior is None or not any(body.contents for body in bodies.values()):
        return entity
    contents = bodies[entity.name].contents
    count = contents.count if contents is not None else 0
    return msgspec.structs.replace(entity, contents=Contents(count, count, 0.0))
