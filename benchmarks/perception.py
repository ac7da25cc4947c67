"""How exact perception is, and how true what it states of itself: over seeded scenes, scored by the truth.

    python benchmarks/perception.py --seeds 12 --rooms 24

Every scene that ships and rooms of the suite `unseen` are built with real contact physics, left to settle, and
looked at three times by the cameras of sensors.yaml at each noise level. The error of every movable object is that of
its latest pose; turns that look the same count as the same. Each stated number is compared with its stated deviation:
reliability is the share of truths within one and within two, by number, and by number and kind of body. In rooms one
object is left out of the inventory, and the map has fixed bodies beside where they are, some of them at a wrong height;
rooms of a second stream have bodies of several solids, and objects that begin tilted or on a board of their size. Two
sequences follow: two like cubes 10 cm apart, of which one is moved past the other, and a cube behind a screen. A mix-up
is a name that ends up on another object. Frozen pictures come with new stamps while the arm moves; without noise, a
still scene gives equal pictures, too. Nothing of the pipeline sees the truth.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import msgspec
import mujoco
import numpy as np
from rich.console import Console
from typer import Option

from benchmarks.perception_parts.reliability import Stated, compare
from benchmarks.perception_parts.stage import Stage, World
from benchmarks.runner import finish, one_of, run, show, show_figures
from benchmarks.unseen_parts.figures import find_interval
from benchmarks.worlds.cases import Case
from benchmarks.worlds.goals import draw_case
from benchmarks.worlds.projects import write_case
from benchmarks.worlds.rooms import COMPOUND, SceneObject
from benchmarks.worlds.table import render_table
from phyagentos.bench.report import Spread, Threshold
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.settings.perception import Prior
from phyagentos.protocol.settings.sensors import Sensors, read_sensors
from phyagentos.protocol.world.environment import Entity, Status
from phyagentos.runtime.perception.forms import Form
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.unknown_objects import is_unknown_object
from phyagentos.runtime.targets.wire import Frames

ROOT = find_shipped_root()
LOOKS = 3
MIXED_UP_M = 0.03  # a name this far from its object, and nearer to another one of the kind, is on the other one
LEVELS = ("none", "mild", "nominal", "harsh")
MOVED_RAD = (0.0, 0.7, 0.0, 0.3, 0.0, 0.1, 0.0)  # of the arm, from over the table to just above it
ROOMS_FROM, COMPOUND_FROM = 70_000, 80_000  # seeds of rooms that nothing else uses
PRIOR_LEVEL, PRIOR_SEEDS = "nominal", 2  # so many seeds of each scene are seen with less prior knowledge, too
PLAIN = {"cube", "box", "slab", "bar"}  # kinds that are left out of an inventory: their sides are known
ASKED = {
    "nominal_position_mm_median": Threshold(5.0, at_least=False),
    "nominal_position_mm_p95": Threshold(15.0, at_least=False),
    "nominal_found": Threshold(0.99, at_least=True),
    "nominal_sequence_mix_ups": Threshold(0, at_least=False),
    "scenes_looked_at": Threshold(100, at_least=True),
}
RELIABLE = Threshold(
    0.95, at_least=True
)  # share of truths within two stated deviations, of every number at every level
OF_KINDS = {  # beside that: of all numbers of all bodies, and of each number of each kind of body
    "pooled_within_2": 0.93,
    "pooled_beyond_2": 0.02,
    "least_bound_of_a_kind": 0.95,
    "least_truths_of_a_kind": 200,
}
TWINS = """
  first: &cube
    kind: cube
    color: red
    material: red
    place: {position_m: [0.48, -0.05, 0.0205], jitter_m: [0.02, 0.0, 0.0], yaw_rad: [-0.7, 0.7]}
    shapes: [{kind: box, size_m: [0.02, 0.02, 0.02]}]
  second:
    <<: *cube
    place: {position_m: [0.48, 0.05, 0.0205], jitter_m: [0.02, 0.0, 0.0], yaw_rad: [-0.7, 0.7]}
  screen:
    kind: screen
    color: blue
    material: blue
    place: {position_m: [0.3, 0.35, 0.0805], jitter_m: [0.01, 0.01, 0.0]}
    shapes: [{kind: box, size_m: [0.01, 0.1, 0.08]}]
"""


@dataclass(slots=True)
class Tally:
    """What one noise level came to."""

    position_mm: list[float] = field(default_factory=list)
    yaw_deg: list[float] = field(default_factory=list)
    tilt_deg: list[float] = field(default_factory=list)
    fixed_mm: list[float] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)
    objects: int = 0
    missed: list[str] = field(default_factory=list)
    mixed_up: list[str] = field(default_factory=list)
    sequences_told: int = 0
    sequence_mix_ups: list[str] = field(default_factory=list)
    stated: list[Stated] = field(default_factory=list)
    frozen: list[bool] = field(default_factory=list)
    suspected: list[bool] = field(default_factory=list)


def score_scene(stage: Stage, name: str, tally: Tally, unnamed: dict[str, SceneObject]) -> None:
    """Look, and compare every object with where it is, and every number with its uncertainty, at first and at last."""
    for number in range(LOOKS):
        belief = stage.look()
        if number in (0, LOOKS - 1):
            tally.stated += compare(stage, belief, unnamed)
    tally.ms += stage.ms
    objects = stage.pipeline.inventory.objects
    for item in objects.values():
        if item.vessel is not None:
            continue  # the filling of a vessel is told as a whole
        entity = belief.entities.get(item.name)
        position, rotation = stage.world.find(item.name)
        is_found = entity is not None and entity.status is Status.SEEN
        if not item.template.movable:
            if entity is not None:
                tally.fixed_mm.append(1e3 * measure_distance(entity, position))
            continue
        tally.objects += 1
        if entity is None or not is_found:
            tally.missed.append(f"{name}: {item.name}")
            continue
        score_pose(entity, item, position, rotation, tally)
        if find_thief(entity, item, objects.values(), stage):
            tally.mixed_up.append(f"{name}: {item.name}")


def score_pose(entity: Entity, item: ObjectModel, position: np.ndarray, rotation: np.ndarray, tally: Tally) -> None:
    """Add one object's errors."""
    tally.position_mm.append(1e3 * measure_distance(entity, position))
    believed = np.zeros(9)
    mujoco.mju_quat2Mat(believed, np.array(entity.pose.quaternion_wxyz))
    turns = [believed.reshape(3, 3) @ symmetry for symmetry in item.symmetries]
    if item.form is not Form.BALL:
        axis = [np.arccos(np.clip(turned[:, 2] @ rotation[:, 2], -1, 1)) for turned in turns]
        tally.tilt_deg.append(float(np.degrees(min(axis))))
    if item.form is Form.BOX:
        angles = [np.arccos(np.clip((np.trace(turned.T @ rotation) - 1) / 2, -1, 1)) for turned in turns]
        tally.yaw_deg.append(float(np.degrees(min(angles))))


def find_thief(
    entity: Entity, item: ObjectModel, objects: Iterator[ObjectModel] | Sequence[ObjectModel], stage: Stage
) -> bool:
    """Whether a name is on another object than its own, and does not say that it may be."""
    own_m = measure_distance(entity, stage.world.find(item.name)[0])
    told = {item.name, *entity.alternatives}
    others = [each.name for each in objects if each.template.movable and each.name not in told and each.vessel is None]
    return own_m > MIXED_UP_M and any(measure_distance(entity, stage.world.find(each)[0]) < own_m for each in others)


def measure_distance(entity: Entity, position: np.ndarray) -> float:
    """Of a believed object from a point [m]."""
    return float(np.linalg.norm(np.array(entity.pose.position_m) - position))


def run_sequences(world: World, sensors: Sensors, level: str, tally: Tally) -> None:
    """Two like cubes: one moved past the other in steps, then one hidden by a screen while the other moves."""
    seed = world.seed
    stage = open_stage(world, sensors, level)
    stage.look()
    real = match_names(stage)
    x_m, y_m = stage.world.find(real["first"])[0][:2]
    for step in range(1, 9):
        stage.world.put(real["first"], x_m + 0.075, y_m + 0.02 * step * np.sign(-y_m), yaw_rad=0.1 * step)
        stage.look()
        count_names(stage, real, f"seed {seed}, passing by, step {step}", tally)
    stage = open_stage(world, sensors, level)
    stage.look()
    real = match_names(stage)
    hidden, moving = ("first", "second") if stage.world.find(real["first"])[0][1] > 0 else ("second", "first")
    place = stage.world.find(real[hidden])[0]
    stage.world.put("screen", *(place[:2] + 0.12 * np.array((0.6, -0.8))), yaw_rad=-0.93)
    stage.look(("right",))
    for y_m in (-0.08, -0.12, -0.16):
        stage.world.put(real[moving], 0.46, y_m)
        stage.look(("right",))
        count_names(stage, real, f"seed {seed}, behind a screen, {y_m}", tally)
    stage.world.put("screen", 0.3, 0.35)
    stage.world.put(real[hidden], place[0] - 0.03, place[1])
    stage.look()
    count_names(stage, real, f"seed {seed}, shown again", tally)


def score_prior(world: World, sensors: Sensors, prior: Prior, tally: Tally) -> None:
    """Movable bodies that are seen where they are: under a name that they may have, or under none."""
    stage = Stage(world, sensors, PRIOR_LEVEL, prior=prior)
    for _ in range(LOOKS):
        belief = stage.look()
    seen = [each for each in belief.entities.values() if each.movable and each.status is Status.SEEN]
    for name, body in world.spec.bodies.items():
        if body.fixed or body.joint is not None or body.part_of or body.place.frame:
            continue
        position, _ = world.find(name)
        own = [each for each in seen if is_unknown_object(each.name) or name in {each.name, *each.alternatives}]
        away_mm = min((1e3 * measure_distance(each, position) for each in own), default=np.inf)
        tally.objects += 1
        if away_mm > 1e3 * MIXED_UP_M:
            tally.missed.append(f"{world.name}, seed {world.seed}: {name}")
        else:
            tally.position_mm.append(away_mm)
    tally.ms += stage.ms


def open_stage(world: World, sensors: Sensors, level: str) -> Stage:
    """A stage of a world as it settled."""
    world.reset()
    return Stage(world, sensors, level)


def run_frozen(world: World, sensors: Sensors, level: str, tally: Tally) -> None:
    """A still scene, the arm that moves in it, and the first pictures with new stamps after that."""
    stage = open_stage(world, sensors, level)
    for _ in range(LOOKS):
        belief = stage.look()
        tally.suspected += [each.status == "frozen" for each in belief.sensors.values()]
    earlier, physics = stage.latest.frames, world.physics
    physics.data.qpos[physics.state.q_address] += MOVED_RAD
    physics.queries.look()
    stage.state = physics.queries.read_target({})
    now = {frame.camera: frame for frame in stage.take_frames().frames}
    changes = {name: {"time_s": frame.time_s, "world_T_camera": frame.world_T_camera} for name, frame in now.items()}
    frozen = Frames(tuple(msgspec.structs.replace(each, **changes[each.camera]) for each in earlier))
    tally.frozen += [each.status == "frozen" for each in stage.sense(frozen).sensors.values()]
    stage.belief = belief
    tally.suspected += [each.status == "frozen" for each in stage.look().sensors.values()]


def match_names(stage: Stage) -> dict[str, str]:
    """Which of the like cubes each name was given to at first: nothing tells them apart but this."""
    belief = stage.belief
    bodies = ("first", "second")
    if belief is None or any(name not in belief.entities for name in bodies):
        return dict(zip(bodies, bodies, strict=True))
    straight = sum(measure_distance(belief.entities[name], stage.world.find(name)[0]) for name in bodies)
    crossed = sum(
        measure_distance(belief.entities[a], stage.world.find(b)[0]) for a, b in zip(bodies, bodies[::-1], strict=True)
    )
    return dict(zip(bodies, bodies if straight <= crossed else bodies[::-1], strict=True))


def count_names(stage: Stage, real: dict[str, str], what: str, tally: Tally) -> None:
    """One association to be judged for each name that claims to be seen, and to be of one object."""
    for name, body in real.items():
        entity = stage.belief.entities.get(name) if stage.belief is not None else None
        tally.sequences_told += entity is not None and bool(entity.alternatives)
        if entity is None or entity.status is not Status.SEEN or entity.alternatives:
            continue
        if measure_distance(entity, stage.world.find(body)[0]) > MIXED_UP_M:
            tally.sequence_mix_ups.append(f"{what}: {name}")


def rate_kinds(stated: Sequence[Stated]) -> dict[str, tuple[int, int, float]]:
    """Of each number of each kind of body: truths within two deviations, all of them, and the share's upper bound."""
    found: dict[str, list[bool]] = {}
    for each in stated:
        found.setdefault(f"{each.number} of {each.kind}", []).append(each.is_within(2))
    return {name: (sum(near), len(near), find_interval(sum(near), len(near))[1]) for name, near in found.items()}


def measure_share(stated: Sequence[Stated], deviations: float) -> float:
    """Of those whose truth is so near."""
    return sum(each.is_within(deviations) for each in stated) / max(len(stated), 1)


def run_worlds(
    library: Library, seeds: int, cases: list[Case], tallies: dict[str, Tally], priors: dict[Prior, Tally]
) -> int:
    """All scenes and rooms at all levels; returns their number."""
    sensors = read_sensors(ROOT / "protocol" / "sensors.yaml")
    scenes = sorted(path.stem for path in (ROOT / "scenes" / "tabletop").glob("*.yaml"))
    worlds: list[tuple[str, int, dict[str, SceneObject]]] = [
        (f"tabletop/{name}", seed, {}) for seed in range(seeds) for name in scenes
    ]
    displaced = dict[str, list[str]]()
    for case in cases:
        plain = [item for item in case.room.movable if item.form.kind in PLAIN and item.on == "table"]
        worlds.append((f"unseen/{case.name}", case.seed, {item.name: item for item in plain[-1:]}))
        under = {item.on for item in case.room.objects.values() if item.fixed}
        displaced[f"unseen/{case.name}"] = [
            item.name
            for item in case.room.objects.values()
            if item.fixed and item.drawn_by == "point" and item.name not in under
        ]
    for scene, seed, unnamed in worlds:
        world = World(library, scene, seed)
        world.open_drawers(seed)
        for level, tally in tallies.items():
            stage = Stage(world, sensors, level, unnamed, displaced=displaced.get(scene, ()))
            score_scene(stage, f"{scene}, seed {seed}", tally, unnamed)
        for prior, tally in priors.items() if seed < PRIOR_SEEDS or (unnamed and seed < COMPOUND_FROM) else ():
            score_prior(world, sensors, prior, tally)
    for seed in range(seeds):
        world = World(library, "bench/twins", seed)
        for level, tally in tallies.items():
            run_sequences(world, sensors, level, tally)
            run_frozen(world, sensors, level, tally)
    return len(worlds)


def main(
    *,
    seeds: Annotated[int, Option(help="of each scene")] = 12,
    rooms: Annotated[int, Option(help="drawn as for the suite unseen")] = 24,
    compound_rooms: Annotated[int, Option(help="drawn as for the suite unseen_compound")] = 24,
    levels: Annotated[list[str], Option(callback=one_of(*LEVELS))] = tuple(LEVELS),
) -> int:
    """Run, show, and exit with whether every asked figure holds."""
    tallies = {level: Tally() for level in levels}
    with tempfile.TemporaryDirectory(prefix="perception-") as scratch:
        cases = [draw_case(ROOMS_FROM + index) for index in range(rooms)]
        cases += [draw_case(COMPOUND_FROM + index, COMPOUND) for index in range(compound_rooms)]
        for case in cases:
            write_case(case, Path(scratch))
        (Path(scratch) / "scenes" / "bench").mkdir(parents=True)
        (Path(scratch) / "scenes" / "bench" / "twins.yaml").write_text(render_table("bench/twins", TWINS))
        priors = {prior: Tally() for prior in Prior}
        scenes = run_worlds(Library.open(Path(scratch)), seeds, cases, tallies, priors)
    figures, asked = {"scenes_looked_at": float(scenes)}, dict(ASKED)
    for level, tally in tallies.items():
        figures |= describe(level, tally)
        asked |= {f"{level}_frozen_told": RELIABLE, f"{level}_honest_suspected": Threshold(0, at_least=False)}
        asked |= {name: RELIABLE for name in figures if name.startswith(level) and name.endswith("_within_2")}
        asked |= {f"{level}_{name}": Threshold(value, at_least=True) for name, value in OF_KINDS.items()}
        for text in (*tally.missed[:8], *tally.mixed_up[:8], *tally.sequence_mix_ups[:8]):
            Console().print(f"{level}: {text}", style="dim")
    for prior, tally in priors.items():
        figures |= {
            f"prior_{prior}_found": 1.0 - len(tally.missed) / max(tally.objects, 1),
            f"prior_{prior}_position_mm_median": Spread.of(tally.position_mm).median,
            f"prior_{prior}_ms_median": Spread.of(tally.ms).median,
        }
    show_figures(f"perception; by prior knowledge: {PRIOR_LEVEL} noise", figures, asked)
    return finish(figures, asked)


def describe(level: str, tally: Tally) -> dict[str, float]:
    """The figures of one noise level; `..._within_2` is the share of truths within two stated deviations."""
    spreads = {"position_mm": tally.position_mm, "yaw_deg": tally.yaw_deg, "tilt_deg": tally.tilt_deg}
    spreads |= {"fixed_mm": tally.fixed_mm, "ms": tally.ms}
    figures = {
        f"{level}_{name}_{at}": getattr(Spread.of(values), at)
        for name, values in spreads.items()
        for at in ("median", "p95")
    }
    figures |= {
        f"{level}_found": 1.0 - len(tally.missed) / max(tally.objects, 1),
        f"{level}_mix_ups": float(len(tally.mixed_up)),
        f"{level}_sequence_mix_ups": float(len(tally.sequence_mix_ups)),
        f"{level}_names_told_exchangeable": float(tally.sequences_told),
        f"{level}_frozen_told": sum(tally.frozen) / max(len(tally.frozen), 1),
        f"{level}_honest_suspected": float(sum(tally.suspected)),
    }
    for number in dict.fromkeys(each.number for each in tally.stated):
        own = [each for each in tally.stated if each.number == number]
        key = f"{level}_{number.replace(' ', '_')}_within"
        figures |= {f"{key}_{within}": measure_share(own, within) for within in (1, 2)}
    kinds = rate_kinds(tally.stated)
    rows = ((name, f"{near} of {count}", f"{bound:.3f}") for name, (near, count, bound) in sorted(kinds.items()))
    show(f"{level}: truths within two stated deviations", ("number", "within", "upper 95 % bound"), rows)
    pooled = measure_share(tally.stated, 2)
    return figures | {
        f"{level}_pooled_within_2": pooled,
        f"{level}_pooled_beyond_2": 1.0 - pooled,
        f"{level}_least_bound_of_a_kind": min((bound for *_, bound in kinds.values()), default=float("nan")),
        f"{level}_least_truths_of_a_kind": float(min((count for _, count, _ in kinds.values()), default=0)),
    }


if __name__ == "__main__":
    run(main)
