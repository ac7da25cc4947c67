"""Skills, targets and scenes from which goals are built."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import (
    read_each,
    read_skill_registry,
    read_target,
    read_target_registry,
)
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime, read_skill
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.alike import find_alike
from phyagentos.protocol.world.scenes import SceneSpec, read_scene


@dataclass(frozen=True, slots=True, kw_only=True)
class Catalogue:
    """Skills, targets and scenes by name, and `problems` of skills and targets that could not be read."""

    skills: Mapping[str, SkillRuntime]
    targets: Mapping[str, TargetProfile]
    scenes: Mapping[str, Path]
    problems: tuple[Problem, ...] = ()

    @classmethod
    def read(cls, library: Library) -> "Catalogue":
        """Everything that a library holds; unreadable parts become `problems`."""
        skills, problems = read_each(library.names_of_skills(), lambda name: read_skill(library.get_skill(name))[0])
        targets, more = read_each(library.names_of_targets(), lambda name: read_target(library.get_target(name)))
        return cls(skills=skills, targets=targets, scenes=_find_scenes(library), problems=(*problems, *more))

    @classmethod
    def of_workspace(cls, workspace: Workspace) -> "Catalogue":
        """What SKILLRUNTIME.md, TARGETS.md and the scenes of a workspace hold.

        Raises:
            DefinitionError: With every problem of the two documents.
        """
        return cls(
            skills=read_skill_registry(workspace.skill_registry),
            targets=read_target_registry(workspace.target_registry),
            scenes=_find_scenes(workspace.library()),
        )

    def find_kinds(self, scene: str) -> dict[str, str] | None:
        """Kind of each listed body, `region` of each region; None when the scene cannot be read, reported elsewhere."""
        content = self.find_scene(scene)
        if content is None:
            return None
        listed = {name: body.kind for name, body in content.bodies.items() if body.listed}
        return dict.fromkeys(content.regions, "region") | listed

    def find_mechanisms(self, scene: str) -> dict[str, str]:
        """How each object with a joint moves, `slide` or `hinge`; empty when the scene cannot be read."""
        content = self.find_scene(scene)
        bodies = content.bodies.items() if content is not None else ()
        return {name: body.joint.kind for name, body in bodies if body.joint is not None}

    def find_alike(self, scene: str) -> dict[str, frozenset[str]]:
        """Objects of a scene that no picture tells from others, and those; empty when it cannot be read."""
        content = self.find_scene(scene)
        if content is None:
            return {}
        found = {name: find_alike(content, name) for name, body in content.bodies.items() if body.listed}
        return {name: others for name, others in found.items() if others}

    def find_scene(self, name: str) -> SceneSpec | None:
        """A scene; None when it cannot be read, reported elsewhere."""
        try:
            return read_scene(self.scenes[name])
        except (KeyError, DefinitionError):
            return None


def _find_scenes(library: Library) -> dict[str, Path]:
    return {name: library.get_scene(name) for name in library.names_of_scenes()}
