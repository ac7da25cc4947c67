"""Scene files: how one looks, what is wrong with how it begins, and a new one from what a run last saw."""

from pathlib import Path

import msgspec
import yaml
from scipy.spatial.transform import Rotation

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.understanding.vocabulary import SURFACES, find_robot
from phyagentos.assembly.project import find_project, get_settings, open_library
from phyagentos.errors import DefinitionError, Problem
from phyagentos.geometry import Pose, compute_tilt
from phyagentos.operations.export import Written
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import name_placed, name_plain
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.documents.schema import read_text
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Status, read_environment
from phyagentos.protocol.world.scenes import NAME, Placement, read_scene

LEAN_RAD = 0.1  # less is the error of a measurement


class CheckedScene(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos scene check --json` prints; `robot` is empty where none fits."""

    file: Path
    robot: str
    problems: tuple[Problem, ...]


class SavedScene(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos scene save --json` prints; `left_out` names objects with the reason."""

    file: Path
    left_out: tuple[str, ...]


def render(path: Path, to: Path, robot: str = "", camera: str = "", seed: int = 0) -> Written:
    """Draw a scene as it begins, with the names of its objects; raises as `draw_scene`."""
    from phyagentos.assembly.scene_picture import draw_scene
    from phyagentos.pictures.labelled import Drawing

    spec, library = read_scene(path), open_library(path)
    robots = _find_robots(library, spec.scene, robot)
    scene = name_placed(spec.scene, [read_target(library.get_target(each)) for each in robots])
    names = [name for name, body in spec.bodies.items() if body.listed and body.kind not in SURFACES]
    draw_scene(library, scene, robots, seed, Drawing(names=names, camera=camera), to, robots_whole=True)
    return Written(file=to)


def check(path: Path, robot: str = "", seed: int = 0) -> CheckedScene:
    """Every problem of how a scene begins: bodies that overlap or float, are out of reach, or in view of no camera.

    Raises DefinitionError where it cannot be read.
    """
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.models.scene_start import find_remote, find_start_problems

    spec, library = read_scene(path), open_library(path)
    problems, robots = find_start_problems(path), _find_robots(library, spec.scene, robot)
    for name in robots:
        here, settings = read_profile(library.get_target(name)), get_settings("sensors.yaml", library, None)
        problems = problems or find_start_problems(path, seed, here)
        problems += find_remote(path, seed, here, read_sensors(settings)) if settings is not None else []
    return CheckedScene(file=path, robot="".join(robots), problems=tuple(problems))


def _find_robots(library: Library, scene: str, robot: str) -> list[str]:
    """The robot that is named, else that of the scene's goal graphs, where it has a model; none where there is none."""
    catalogue = Catalogue.read(library)
    if robot and robot not in catalogue.targets:
        raise DefinitionError.unknown("target", "--robot", robot, catalogue.targets)
    graphs = [path for root in library.roots for path in sorted((root / "goal_graphs").glob("*.yaml"))]
    name = robot or find_robot(catalogue, graphs, scene)
    return [name] if name in catalogue.targets and catalogue.targets[name].model else []


def save(name: str, workspace: Path, folder: Path) -> SavedScene:
    """Write a scene whose objects begin where a run last saw them; the rest is as in the scene of that run.

    Raises DefinitionError `WOULD_OVERWRITE`, `NOT_OBSERVED`, `INVALID_VALUE` where a robot placed its scene.
    """
    space, to = Workspace.open(workspace), folder / "scenes" / f"{name}.yaml"
    known = read_environment(read_text(space.environment), str(space.environment))
    if name_plain(known.scene) != known.scene:
        raise DefinitionError.of("INVALID_VALUE", str(space.environment), known.scene, "a scene that no robot scales")
    if not all(map(NAME.fullmatch, name.split("/"))):
        raise DefinitionError.of(
            "INVALID_VALUE", "name of the scene", repr(name), "letters, digits and '_', with a letter first"
        )
    if to.exists():
        raise DefinitionError.of("WOULD_OVERWRITE", str(to), "a scene", "a new name")
    path = open_library(find_project(workspace)).get_scene(known.scene)
    spec = read_scene(path)
    bodies, left_out = (
        dict(spec.bodies),
        [f"{each}: it has no name" for each in known.entities if each not in spec.bodies],
    )
    for each in (known.entities[each] for each in spec.bodies if each in known.entities):
        if each.held_by or each.status is Status.GONE:
            left_out.append(f"{each.name}: {f'{each.held_by} holds it' if each.held_by else 'it is gone'}")
            del bodies[each.name]
        elif (joint := bodies[each.name].joint) is not None and each.mechanism is not None and each.joint is not None:
            moved = {
                "place": _describe_place(each.mechanism.closed),
                "joint": joint.model_copy(update={"opening": (each.joint, each.joint)}),
            }
            bodies[each.name] = bodies[each.name].model_copy(update=moved)
        elif not each.part_of:
            bodies[each.name] = bodies[each.name].model_copy(update={"place": _describe_place(each.pose)})
    parts = {"scene": name, "description": f"{known.scene} as seen at {known.time_s:.1f} s.", "bodies": bodies}
    saved = spec.model_copy(update={**parts, "rows": (), "stacks": ()})
    data = saved.model_dump(mode="json", exclude_defaults=True)
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_text(
        yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None), encoding="utf-8"
    )
    return SavedScene(file=to, left_out=tuple(left_out))


def _describe_place(pose: Pose) -> Placement:
    """Where a body stands; its yaw alone where it is upright."""
    w, *xyz = pose.quaternion_wxyz
    x_rad, y_rad, z_rad = Rotation.from_quat([*xyz, w]).as_euler("XYZ").round(4).tolist()
    x, y, z = (round(each, 4) for each in pose.position_m)
    if compute_tilt(pose) > LEAN_RAD:
        return Placement(position_m=(x, y, z), euler_rad=(x_rad, y_rad, z_rad))
    return Placement(position_m=(x, y, z), yaw_rad=(z_rad, z_rad))
