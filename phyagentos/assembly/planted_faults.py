"""Which faults of a run's fault file cannot strike, and which never struck: about them a run shows nothing."""

import fnmatch
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

import msgspec

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.assembly.paths import FAULTS as FILE
from phyagentos.assembly.project import get_settings
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.sessions.evidence import FAULTS, Event
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.faults import CameraFault, Push, Stall, read_faults
from phyagentos.protocol.world.scenes import read_scene


def check_planted(
    path: Path, graph: GoalGraph, catalogue: Catalogue, library: Library, workspace: Path | None = None, goal: str = "*"
) -> list[Problem]:
    """Names of a fault file that the scene and the robots of a goal, or the project's sensors.yaml, do not have.

    `goal` is the id that the goal will have, where it is known: faults for sessions of other goals are passed over.

    Raises DefinitionError of a file that cannot be read.
    """
    targets = {catalogue.targets[choice.target] for choice in graph.choices.values()}
    joints = {joint for target in targets for joint in target.arm.joints}
    sensors = get_settings("sensors.yaml", library, workspace)
    cameras = read_sensors(sensors).cameras if sensors is not None else None
    bodies = read_scene(library.get_scene(graph.spec.scene)).bodies
    return [*iter_misses(path, bodies, joints, cameras, graph.nodes, goal)]


def iter_misses(
    path: Path,
    bodies: Collection[str],
    joints: Collection[str],
    cameras: Collection[str] | None,
    nodes: Collection[str],
    goal: str = "*",
) -> Iterator[Problem]:
    """Names of a sound fault file that scene, robots, sensors.yaml (None: not known) and goal graph do not have."""
    located, file = read_yaml(path), read_faults(path)
    for index, fault in enumerate(file.faults):
        place = ("faults", index)
        pattern = fault.when.session or "*"
        of_goal, _, of_node = pattern.partition(".")
        if goal != "*" and not fnmatch.fnmatchcase(goal, of_goal):
            continue
        if of_node and not fnmatch.filter((each + child for each in nodes for child in ("", ".r1")), of_node):
            known = (f"{of_goal}.{each}" for each in nodes)
            yield located.unknown("session", (*place, "when", "session"), pattern, known)
        if fault.object and fault.object not in bodies:
            yield located.unknown("object", (*place, "object"), fault.object, bodies)
        if isinstance(fault, Stall | Push) and fault.joint not in joints:
            yield located.unknown("joint", (*place, "joint"), fault.joint, joints)
        if isinstance(fault, CameraFault) and cameras is not None and not fnmatch.filter(cameras, fault.camera):
            yield located.unknown("sensor", (*place, "camera"), fault.camera, cameras)
    for index, name in enumerate(file.draw.objects if file.draw is not None else ()):
        if name not in bodies:
            yield located.unknown("object", ("draw", "objects", index), name, bodies)


def find_unstruck(workspace: Path) -> tuple[str, ...]:
    """`slip of red_cube`: faults of the file that no bundle of the workspace records; empty without a file."""
    path = workspace / FILE
    if not path.is_file():
        return ()
    try:
        planted = read_faults(path)
    except DefinitionError:
        return ()
    struck = Counter(dict.fromkeys(_iter_strikes(workspace), 1))
    missing = []
    for fault in planted.faults:
        body = fault.joint if isinstance(fault, Stall | Push) else fault.object or getattr(fault, "camera", "")
        bodies = {body, getattr(fault, "camera", body)}
        found = next((each for each in struck if each[0] == fault.kind and each[1] in bodies and struck[each]), None)
        if found is None:
            missing.append(f"{fault.kind} of {body}")
        else:
            struck[found] = 0
    if planted.draw is not None and not any(struck.values()):
        missing.append(f"one of {', '.join(planted.draw.one_of)}, of {' or '.join(planted.draw.objects)}")
    return tuple(missing)


def _iter_strikes(workspace: Path) -> Iterator[tuple[str, str, float]]:
    """Kind, body and time of each; a fault that lasts stands in several bundles."""
    for file in sorted(workspace.glob(f"evidence/*/{FAULTS}")):
        try:
            strikes = msgspec.json.decode(file.read_bytes(), type=list[Event])
        except msgspec.MsgspecError:
            continue
        yield from ((each.kind, str(each.details.get("body", "")), each.time_s) for each in strikes)
