"""A scene with its robots as one MuJoCo model, and the state that is stepped.

A scene's only robot is the root of the model, so that its names stay as its file gives them. Of several, each is
attached with its target's name as prefix: `left_arm/joint1`. Robots collide with each other; each keeps the exclusions
of its own body.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Entity, Region
from phyagentos.protocol.world.friction import Surface
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.models.allowed_collisions import compute_collision_matrix, exclude_pairs
from phyagentos.runtime.models.base import SOLE
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.hand import HandMotion, measure_hand
from phyagentos.runtime.models.robot import build_robot
from phyagentos.runtime.models.scene import add_scene, draw_bodies, read_regions
from phyagentos.runtime.models.sources import find_models
from phyagentos.runtime.models.surfaces import add_pairs, find_idealised

Robot = tuple[TargetProfile, Path]


@dataclass(frozen=True, slots=True)
class CompiledScene:
    """Robots and objects, compiled into one model, and the state that is stepped; entities at their start."""

    spec: mujoco.MjSpec
    model: mujoco.MjModel
    data: mujoco.MjData
    entities: tuple[Entity, ...]
    regions: tuple[Region, ...]
    model_sha256: str
    seed: int
    balls: tuple[str, ...]  # bodies of the contents of vessels
    hands: Mapping[str, HandMotion]  # of each target
    idealised: tuple[str, ...] = ()  # bodies whose friction is not by pairs of surfaces
    _files: dict[str, bytes] = field(default_factory=dict)

    def export(self) -> dict[str, bytes]:
        """The scene as files, as it was at the first call: `scene.mjb`, compiled, and `scene.xml`."""
        if not self._files:
            self._files.update({"scene.mjb": _read_bytes(self.model), "scene.xml": self.spec.to_xml().encode()})
        return self._files


def name_prefix(target: str, robots: int) -> str:
    """Prefix of a robot's names in a model of so many robots."""
    return f"{target}/" if robots > 1 else ""


def compile_scene(robots: Sequence[Robot], spec: SceneSpec, seed: int) -> CompiledScene:
    """Robots, each with the folder of its model, in a scene.

    Raises:
        DefinitionError: `WORLD_CONFLICT` when the robots have different control periods or physics steps.
        ExecutionError: `SCENE_INVALID`.
    """
    balls = spec.list_balls()
    spec = spec.model_copy(update={"bodies": spec.bodies | balls})
    placed = draw_bodies(spec, seed)
    world = _join(robots)
    world.option.timestep = robots[0][0].physics_step_s
    world.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    world.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    world.option.impratio = 10.0
    world.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # divergence is reported, not reset
    world.visual.quality.shadowsize = 4096
    world.visual.headlight.ambient = [0.35, 0.35, 0.35]
    world.visual.headlight.diffuse = [0.25, 0.25, 0.25]
    world.visual.map.znear = 0.01
    add_scene(world, spec, placed)
    add_pairs(world, spec, {item.name: item.grip for item in placed}, _list_pads(robots, world), seed)
    model = compile_model(world, *(path for robot in robots for path in find_models(*robot)))
    return CompiledScene(
        spec=world,
        model=model,
        data=mujoco.MjData(model),
        entities=tuple(item.as_entity() for item in placed if item.name not in balls),
        balls=tuple(balls),
        hands={profile.target: measure_hand(profile, folder) for profile, folder in robots},
        regions=read_regions(spec, placed),
        model_sha256=hashlib.sha256(_read_bytes(model)).hexdigest(),
        seed=seed,
        idealised=tuple(find_idealised(spec)),
    )


def _list_pads(robots: Sequence[Robot], world: mujoco.MjSpec) -> dict[str, Surface]:
    """Pads of grippers and soles of legs, with what they are made of."""
    soles = {
        name_prefix(profile.target, len(robots)) + SOLE: profile.base.sole_surface
        for profile, _ in robots
        if profile.base is not None and profile.base.sole_surface is not None
    }
    found = {geom.name: soles[begin] for geom in world.geoms for begin in soles if geom.name.startswith(begin)}
    return found | {
        name_prefix(profile.target, len(robots)) + pad: profile.gripper.pad_surface
        for profile, _ in robots
        for pad in profile.gripper.pads
        if profile.gripper.pad_surface is not None
    }


def _read_bytes(model: mujoco.MjModel) -> bytes:
    buffer = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def _join(robots: Sequence[Robot]) -> mujoco.MjSpec:
    """The robots alone; the only one as it is, several with prefixes."""
    specs = []
    for profile, folder in robots:
        robot = build_robot(profile, folder, is_free=True)
        exclude_pairs(robot, compute_collision_matrix(profile, folder).excluded)
        specs.append(robot)
    if len(specs) == 1:
        return specs[0]
    periods = {profile.target: (profile.control_period_s, profile.physics_step_s) for profile, _ in robots}
    if len(set(periods.values())) > 1:
        raise DefinitionError.of(
            "WORLD_CONFLICT",
            address="control_period_s and physics_step_s of the targets of one world",
            found=", ".join(f"{target}: {period_s} s, {step_s} s" for target, (period_s, step_s) in periods.items()),
            expected="the same control period and physics step for all",
        )
    world = mujoco.MjSpec()
    for (profile, _), robot in zip(robots, specs, strict=True):
        world.attach(robot, prefix=name_prefix(profile.target, len(robots)), frame=world.worldbody.add_frame())
    return world
