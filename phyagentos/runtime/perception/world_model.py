"""The world as one target perceives it, and its one verb: `observe`, with a need.

An answer stays valid until a command is carried out: at most one look a step. For scoring and for tests the world is
the simulator's ground truth (`sensing: truth`).
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import msgspec
from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.looks import Pointer, name_picture, shows
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.world.descriptions import name_described
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.perception.look import FrameSource, Look
from phyagentos.runtime.targets.wire import Capture, Frames, Observation, Step


@dataclass(frozen=True, slots=True)
class Need:
    """Required content of an answer: a new look at everything or at some objects, or only the held object."""

    everything: bool = False
    objects: frozenset[str] = frozenset()
    only_hand: bool = False

    @property
    def is_look(self) -> bool:
        """Whether it needs a look."""
        return self.everything or bool(self.objects)


@dataclass(frozen=True, slots=True)
class ConfirmationCapture:
    """Frames that are taken at the end of a period, while the next one is on its way.

    `window` shows the objects that are to be confirmed where they are believed to be, None without any; `probe` shows
    that the cameras are alive, None while an earlier proof lasts.
    """

    objects: frozenset[str]
    window: Capture | None
    probe: Capture | None

    @property
    def captures(self) -> tuple[Capture, ...]:
        """What to ask the target for, in this order."""
        return tuple(each for each in (self.probe, self.window) if each is not None)


WORLD = Need(everything=True)
BELIEF = Need()
"""What is believed now: what is held has moved with the hand, nothing is looked at anew."""
HAND = Need(only_hand=True)


class WorldModel(ABC):
    """Perception of one target, whose state comes with the postures of its profile, where it has one.

    `looks` are whole looks since `enter`, after the latest one before it; empty without perception.
    """

    def __init__(self, target: str, handle: FrameSource, profile: TargetProfile | None = None) -> None:
        self._target, self._handle, self._profile = target, handle, profile
        self._current_scene: Scene | None = None
        self._step: Step | None = None
        self._present: Environment | None = None
        self._is_looked_at = False
        self.looks: list[Look] = []
        self.latest_look: Look | None = None
        self._pictures: dict[str, list[Look]] = {}  # camera@time -> looks that hold that picture

    def enter(self, scene: Scene) -> None:
        """Observe this scene from now on; of earlier looks only the latest is kept."""
        self._current_scene, self._present, self._step = scene, None, self._handle.latest
        del self.looks[:-1]

    @abstractmethod
    def observe(self, need: Need) -> Environment:
        """The present world, with at least the needed content.

        Raises:
            ExecutionError: `REQUEST_INVALID` before `enter`; `TARGET_LOST`.
        """

    def plan_confirmation(self, objects: frozenset[str], time_s: float) -> ConfirmationCapture | None:
        """The frames that may confirm these objects at `time_s`, the end of the period that was sent last.

        None where the world has to stand for a look.
        """
        return None if objects else ConfirmationCapture(objects, window=None, probe=None)

    def read_confirmation(self, confirmation: ConfirmationCapture, frames: Sequence[Frames]) -> Environment | None:
        """The world at the latest step, confirmed by the frames of a confirmation, in the order of its captures.

        None where uncertain: the objects are to be observed while the world stands.
        """
        return None

    @property
    def step(self) -> Step:
        """The latest step of the session that has authority, or had it last."""
        return self._step or self._handle.step

    def advance(self, step: Step, *, stands: bool = True) -> None:
        """A command was carried out: the present answer expires.

        The world `stands` at this step, and can be looked at, unless another command is on its way.
        """
        self._step, self._present = step, None

    def restore(self, belief: Environment, looks: Collection[Look] = ()) -> None:
        """Continue from a recorded belief and, where kept, the looks behind it."""
        self._present, self.looks, self._pictures = None, [], {}
        for look in looks:
            self._keep(look, belief)

    def find_looks(self, world: Environment) -> list[Look]:
        """The known looks that show the pixels of this world's pointers."""
        pointers = {pointer for entity in world.entities.values() for pointer in entity.evidence}
        found: dict[int, Look] = {}
        for pointer in Pointer.parse_all(sorted(pointers)):
            looks = reversed(self._pictures.get(pointer.picture, []))
            if look := next((look for look in looks if shows(look.captures, pointer)), None):
                found[id(look)] = look
        return list(found.values())

    def _keep(self, look: Look, belief: Environment) -> None:
        """Remember a look; of earlier pictures, those that the belief still points at."""
        self.latest_look = look
        for frame in (frame for _, frames in look.captures for frame in frames.frames):
            self._pictures.setdefault(name_picture(frame.camera, frame.time_s), []).append(look)
        if not look.objects:
            self.looks.append(look)
            entities = belief.entities.values()
            pointed = {each.picture for entity in entities for each in Pointer.parse_all(entity.evidence)}
            self._pictures = {name: looks for name, looks in self._pictures.items() if name in pointed}

    @property
    def _scene(self) -> Scene:
        if self._current_scene is None:
            raise ExecutionError("REQUEST_INVALID", "no scene is observed; call enter() first")
        return self._current_scene

    def _find_present(self, need: Need) -> Environment | None:
        """The answer since the latest command, if it meets the need."""
        return self._present if self._is_looked_at or not need.is_look else None

    def _answer(self, world: Environment, need: Need) -> Environment:
        """The same world, with the target's postures; kept as the answer until the next command."""
        if self._profile is not None and self._profile.postures:
            postures, std_rad = self._profile.postures, self._profile.arm.position_noise_rad
            state = msgspec.structs.replace(world.targets[self._target], postures=postures, q_std_rad=std_rad)
            world = msgspec.structs.replace(world, targets=world.targets | {self._target: state})
        self._present, self._is_looked_at = world, need.everything
        return world


class GroundTruthWorldModel(WorldModel):
    """Reports what the handle's observations hold: the simulator's ground truth, or a robot that has no camera."""

    def __init__(
        self, target: str, handle: FrameSource, sensing: str = "truth", *, profile: TargetProfile | None = None
    ) -> None:
        super().__init__(target, handle, profile)
        self._sensing = sensing
        self._revision = 0
        self._names: dict[str, str] = {}  # by description, of bodies

    @override
    def observe(self, need: Need) -> Environment:
        if (present := self._find_present(need)) is not None:
            return present
        if need.only_hand:  # entities and regions only where they are needed
            return self._describe(self._handle.step)
        observation = self._handle.observe()
        self._revision += 1
        return self._answer(self._describe(observation), need)

    def _describe(self, now: Observation | Step) -> Environment:
        entities, regions = (now.entities, now.regions) if isinstance(now, Observation) else ((), ())
        named = name_described({entity.name: entity for entity in entities}, self._scene.described)
        given = (entity for entity in named.values() if entity.described)
        self._names |= {body.name: entity.name for entity in given for body in entities if body.pose is entity.pose}
        others = {each.name: each.target for each in now.neighbours} if isinstance(now, Observation) else {}
        holding = tuple(self._names.get(name, name) for name in now.target.holding)
        return Environment(
            time_s=now.time_s,
            scene=self._scene.name,
            episode=self._scene.episode,
            revision=self._revision,
            sensing=self._sensing,
            entities=named,
            regions={region.name: region for region in regions},
            targets={self._target: msgspec.structs.replace(now.target, holding=holding)} | others,
        )
