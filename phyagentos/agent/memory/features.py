"""What a session is about, as kinds of things: the same words in episodes and in queries.

Contracts, the scene's inventory and target profiles are known before anything is observed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.placed_scenes import name_plain
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime, find_roles
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.memory_entries import Embodiment
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.scenes import Body, SceneSpec, read_scene

SMALL_M, LARGE_M = 0.03, 0.07  # longest half side of what a hand calls small and large


class Features(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a session is about; empty where the inventory does not know it."""

    object: str = ""
    object_kind: str = ""
    object_color: str = ""
    object_size: str = ""
    destination: str = ""
    destination_kind: str = ""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Declarations of skills, inventories of scenes and bodies of targets, by name."""

    skills: Mapping[str, SkillRuntime]
    scenes: Mapping[str, Path]
    targets: Mapping[str, TargetProfile]
    _read: dict[str, SceneSpec | None] = field(default_factory=dict)

    def describe(self, session: Session) -> Features:
        """The features of a contract; what the inventory does not know stays empty."""
        scene = self._find_scene(session.scene.name)
        skill = self.skills.get(session.skill)
        thing, place = (str(session.parameters.get(key, "")) for key in (find_roles(skill) if skill else ("", "")))
        body = scene.bodies.get(thing) if scene else None
        return Features(
            object=thing,
            object_kind=body.kind if body else "",
            object_color=body.color if body else "",
            object_size=_compute_size(body) if body else "",
            destination=place,
            destination_kind=_find_kind(scene, place),
        )

    def describe_target(self, name: str) -> Embodiment:
        """The body of a target, as far as experience depends on it."""
        profile = self.targets.get(name)
        if profile is None:
            return Embodiment()
        gripper = profile.gripper
        return Embodiment(
            kind=profile.embodiment,
            grip_width_m=gripper.max_width_m,
            grip_force_n=gripper.force_n,
            control_period_s=profile.control_period_s,
        )

    def _find_scene(self, placed: str) -> SceneSpec | None:
        name = name_plain(placed)
        if name not in self._read:
            try:
                self._read[name] = read_scene(self.scenes[name]) if name in self.scenes else None
            except (DefinitionError, OSError):  # reported where the goal is linted
                self._read[name] = None
        return self._read[name]


def _compute_size(body: Body) -> str:
    longest_m = max(max(solid.size_m) for solid in body.shapes)
    return "small" if longest_m < SMALL_M else "large" if longest_m > LARGE_M else "medium"


def _find_kind(scene: SceneSpec | None, place: str) -> str:
    if scene is None:
        return ""
    if place in scene.bodies:
        return scene.bodies[place].kind
    return "region" if place in scene.regions else ""
