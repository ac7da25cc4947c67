"""A scene as it begins with a seed, its robots at home, as a picture: before any process runs."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import mujoco

from phyagentos.pictures.labelled import Drawing, draw_labelled
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.runtime.models.scene import add_scene, draw_bodies
from phyagentos.runtime.models.scene_start import pose_start
from phyagentos.runtime.models.world import compile_scene


def draw_scene(
    library: Library, scene: str, targets: Iterable[str], seed: int, drawing: Drawing, to: Path, *,
    robots_whole: bool = False,
) -> None:  # fmt: skip
    """Write the picture of a scene, by its name as placed for these targets; unknown targets are left out.

    Without a camera the named objects fill it, or, with `robots_whole`, these and their robots.

    Raises:
        DefinitionError: Of the scene, of a robot's model, or of what is drawn; `NO_GRAPHICS`.
        ExecutionError: `SCENE_INVALID`.
    """
    spec = read_placed(library, scene)
    paths = [library.get_target(name) for name in targets if name in library.names_of_targets()]
    robots = [(profile, path.parent) for path in paths if (profile := read_target(path)).model]
    if robots:
        model = compile_scene(robots, spec, seed).model
    else:
        world = mujoco.MjSpec()
        add_scene(world, spec, draw_bodies(spec, seed))
        model = world.compile()
    bodies = (model.body(each) for each in range(1, model.nbody))
    of_robots = [each.name for each in bodies if model.body(each.rootid[0]).name not in spec.bodies]
    shown = replace(drawing, whole=of_robots) if robots_whole else drawing
    picture = draw_labelled(model, pose_start(model, robots), shown)
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_bytes(picture)
