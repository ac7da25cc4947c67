"""The world as a scene begins with a seed, before any process runs: what plans are made for ahead of a run."""

from collections.abc import Iterable

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import name_placed, read_placed
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.world.environment import Environment


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
        entities={item.name: item.as_entity() for item in placed},
        regions={region.name: region for region in read_regions(spec, placed)},
    )
