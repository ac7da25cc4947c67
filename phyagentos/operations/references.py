"""Names in one authored file that stand for what another one holds, each looked up among all that is found from here.

Whether it fits the goal at hand is for the checks of that goal; a name that stands for nothing fits none.
"""

import contextlib
from collections.abc import Collection, Iterable, Iterator
from functools import cached_property
from itertools import chain
from pathlib import Path

from msgspec.structs import replace

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.assembly.drivers import DRIVERS
from phyagentos.assembly.planted_faults import iter_misses
from phyagentos.assembly.project import get_settings
from phyagentos.errors import DefinitionError, Problem, format_hint
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import Address, Located, read_yaml
from phyagentos.protocol.predicates.measured import METRICS, list_measured
from phyagentos.protocol.settings.perception import Embedded, Perception
from phyagentos.protocol.settings.runtime_contract import RuntimeContract, read_runtime_contract
from phyagentos.protocol.settings.safety import Safety
from phyagentos.protocol.settings.sensors import WORLD, Sensors, read_sensors
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.preflight.policy_checks import iter_policy_problems
from phyagentos.runtime.preflight.sensing import BODY_FRAMES, MODALITIES, PERCEIVED

FIXES = {
    "body": "Write `world`, `hand`, or a body of the robot's model.",
    "observation": "Write one of these; a new one is provided by a sensor, offered by a target, and needed by a skill.",
    "resource": "Add it to `resources` of runtime_contract.yaml.",
    "target": "Write one of these; robots/NAME/target.yaml makes a new one.",
}

OFFERED = {"observations": "observation", "actions": "action", "capabilities": "capability"}  # of a target

Reference = tuple[str, Address, str, Collection[str]]  # kind of a name, its place, itself, what it may be


class Names:
    """What a file in the folder `beside` can name, by kind; each kind is read when it is asked for."""

    def __init__(self, library: Library, beside: Path) -> None:
        self._library, self._beside = library, beside

    @cached_property
    def catalogue(self) -> Catalogue:
        """Skills, targets and scenes."""
        return Catalogue.read(self._library)

    @cached_property
    def scenes(self) -> tuple[SceneSpec, ...]:
        """Those that can be read."""
        return tuple(each for each in map(self.catalogue.find_scene, self.catalogue.scenes) if each is not None)

    @cached_property
    def sensors(self) -> Sensors:
        """Those of the project; none where they cannot be read, which is reported at their file."""
        path = get_settings("sensors.yaml", self._library, self._beside)
        try:
            return read_sensors(path) if path is not None else Sensors(sensors={})
        except DefinitionError:
            return Sensors(sensors={})

    @cached_property
    def nodes(self) -> Collection[str]:
        """Those of the goal graphs that can be read."""
        found: set[str] = set()
        for file in chain.from_iterable((each / "goal_graphs").glob("*.yaml") for each in self._library.roots):
            with contextlib.suppress(DefinitionError):
                found.update(read_yaml(file).data.get("sessions") or ())
        return found

    @cached_property
    def resources(self) -> Collection[str]:
        """Those of the project's runtime_contract.yaml."""
        path = get_settings("runtime_contract.yaml", self._library, self._beside)
        try:
            return read_runtime_contract(path).resources if path is not None else ()
        except DefinitionError:
            return ()

    @cached_property
    def measured(self) -> Collection[str]:
        """Observations that a sensor of the project provides, or perception makes."""
        return {*PERCEIVED, *chain.from_iterable(each.provides for each in self.sensors.sensors.values())}

    def find_wanted(self, key: str) -> set[str]:
        """What skills need of a target: `observations`, `actions` or `capabilities`."""
        streams = (each.policy.observations for each in self.catalogue.skills.values() if each.policy is not None)
        needed = chain.from_iterable(getattr(each.needs, key) for each in self.catalogue.skills.values())
        return {*needed, *(chain.from_iterable(streams) if key == "observations" else ())}

    def find_offered(self, key: str, but: str = "") -> set[str]:
        """What targets offer of the same, `but` one."""
        others = (each for name, each in self.catalogue.targets.items() if name != but)
        return set(chain.from_iterable(getattr(each, key) for each in others))

    def iter_misses(self, faults: Path) -> Iterator[Problem]:
        """Names of a fault file that no scene, no robot, no camera and no goal graph here has."""
        profiles = self.catalogue.targets.values()
        joints = set(chain.from_iterable(each.arm.joints for each in profiles))
        bodies = set(chain.from_iterable(each.bodies for each in self.scenes))
        return iter_misses(faults, bodies, joints, self.sensors.cameras, self.nodes)

    def find_nearest(self, joints: Collection[str]) -> TargetProfile | None:
        """The target that has most of these joints; None without any target."""
        profiles = self.catalogue.targets.values()
        return max(profiles, key=lambda each: len(set(each.arm.joints) & set(joints)), default=None)

    def find_carriers(self) -> set[str]:
        """Bodies that may carry a camera: of each robot whose model is here, and of each scene."""
        from phyagentos.runtime.models.robot import MOUNT, read_robot  # MuJoCo, which a client does not have

        bodies = {WORLD, MOUNT, *chain.from_iterable(each.bodies for each in self.scenes)}
        for name, profile in self.catalogue.targets.items():
            try:
                model = read_robot(profile, self._library.get_target(name).parent) if profile.model else None
            except DefinitionError:  # its model is not here, or is reported at its profile
                continue
            bodies |= {each.name for each in model.bodies} if model is not None else set()
        return bodies


def iter_unknown(located: Located, references: Iterable[Reference]) -> Iterator[Problem]:
    """Those references that stand for nothing."""
    for kind, path, name, known in references:
        if name not in known:
            fix = FIXES.get(kind, "Write one of these.")
            yield Problem.unknown(kind, located.address_of(path), name, known, fix=fix)


def iter_of_graph(graph: GoalGraph, names: Names) -> Iterator[Reference]:
    """The resources of its nodes."""
    for node in graph.nodes.values():
        for index, name in enumerate(node.spec.resources):
            yield "resource", (*node.path, "resources", index), name, names.resources


def iter_of_skill(skill: SkillRuntime, names: Names) -> Iterator[Reference]:
    """Its resources, capabilities, and what its policy takes and moves."""
    for index, name in enumerate(skill.needs.resources):
        yield "resource", ("needs", "resources", index), name, names.resources
    for index, name in enumerate(skill.needs.capabilities):
        yield "capability", ("needs", "capabilities", index), name, names.find_offered("capabilities")
    moved = skill.action_space.joints if skill.action_space is not None else ()
    nearest = names.find_nearest(moved)
    if nearest is not None:
        for index, name in enumerate(moved):
            yield "joint", ("action_space", "joints", index), name, nearest.arm.joints


def iter_policy_misfits(skill: SkillRuntime, located: Located, names: Names) -> Iterator[Problem]:
    """What preflight finds in the declaration of a policy, on the target that it fits best."""
    profile = names.find_nearest(skill.action_space.joints if skill.action_space is not None else ())
    if skill.policy is None or profile is None:
        return
    for each in iter_policy_problems(skill, profile, names.sensors, Embedded().max_age_s):
        root, _, path = each.address.partition(".")
        at: Address = tuple(path.split("."))
        yield replace(each, address=located.address_of(at)) if root == "skill" else each


def iter_of_target(profile: TargetProfile, names: Names) -> Iterator[Reference]:
    """What it offers: something that a skill needs, a sensor measures, or another target offers; and its driver.

    A driver may be of a package that is not installed, a capability one that no skill needs yet: both are looked up
    only where a known one is called almost so.
    """
    drivers = DRIVERS.names()
    if profile.driver and format_hint(profile.driver, drivers):
        yield "driver", ("driver",), profile.driver, drivers
    for key, kind in OFFERED.items():
        known = names.find_wanted(key) | names.find_offered(key, but=profile.target)
        known |= set(names.measured) if key == "observations" else set()
        for index, name in enumerate(getattr(profile, key)):
            if key != "capabilities" or format_hint(name, known):
                yield kind, (key, index), name, known


def iter_of_settings(settings: object, names: Names) -> Iterator[Reference]:
    """Of one of the settings files."""
    match settings:
        case Sensors():
            yield from _iter_of_sensors(settings, names)
        case Perception():
            known = {*PERCEIVED.values(), *names.measured}
            for name, pipeline in settings.pipelines.items():
                for index, each in enumerate(pipeline.produces):
                    yield "fact", ("pipelines", name, "produces", index), each, known
                for index, each in enumerate(pipeline.sensors):
                    yield "sensor", ("pipelines", name, "sensors", index), each, names.sensors.sensors
        case RuntimeContract():
            for index, each in enumerate(settings.record.cameras if settings.record is not None else ()):
                yield "camera", ("record", "cameras", index), each, names.sensors.cameras
            for index, text in enumerate(settings.verification.criteria):
                for each in list_measured(text):
                    yield "metric", ("verification", "criteria", index), each, METRICS
        case Safety():
            for each in settings.targets:
                yield "target", ("targets", each), each, names.catalogue.targets


def _iter_of_sensors(sensors: Sensors, names: Names) -> Iterator[Reference]:
    from phyagentos.runtime.models.robot import MOUNT  # as above

    words = {*MODALITIES, *names.find_wanted("observations"), *names.find_offered("observations")}
    seen = set(chain.from_iterable(each.cameras for each in names.scenes))
    is_foreign = any(each.driver for each in names.catalogue.targets.values())  # then cameras are those of its world
    for name, sensor in sensors.sensors.items():
        at: Address = ("sensors", name)
        for index, each in enumerate(sensor.provides):
            yield "observation", (*at, "provides", index), each, words
        if not is_foreign:
            yield "frame", (*at, "frame"), sensor.frame, {*BODY_FRAMES, *sensors.cameras, *seen}
        for each in sensor.signals:
            yield "observation", (*at, "signals", each), each, sensor.provides
        camera = sensor.camera
        if camera is not None and camera.scene_camera and not is_foreign:
            yield "camera", (*at, "camera", "scene_camera"), camera.scene_camera, seen
        if camera is not None and camera.mount not in {WORLD, MOUNT} and not is_foreign:
            yield "body", (*at, "camera", "mount"), camera.mount, names.find_carriers()
