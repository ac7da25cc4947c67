"""How exact perception is: pose errors and mix-ups of the embedded pipeline over seeded scenes, scored by the truth.

    python benchmarks/perception.py --seeds 12

Every scene that ships is built with real contact physics, left to settle, and looked at three times by the cameras of
sensors.yaml at each noise level. The error of every movable thing is that of its latest pose; turns that look the same
count as the same. Two sequences follow: two like cubes 10 cm apart, of which one is moved past the other, and a cube
behind a screen. A mix-up is a name that ends up on another thing. Nothing of the pipeline sees the truth.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from phyagentos.bench.report import Ask, Spread, format_outcome
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.sensors import Sensors, read_sensors
from phyagentos.protocol.world.environment import Entity, Environment, Status
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.perception.inventory import Form, ObjectModel, build_inventory
from phyagentos.runtime.perception.pipeline import Pipeline
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.targets.wire import Frames

ROOT = find_shipped_root()
LOOKS = 3
LOOK_S = 0.2  # between two looks
MIXED_UP_M = 0.03  # a name this far from its thing, and nearer to another one of the kind, is on the other one
LIFTED_M = 0.25
ASKED = {
    "nominal_position_mm_median": Ask(5.0, at_least=False),
    "nominal_position_mm_p95": Ask(15.0, at_least=False),
    "nominal_found": Ask(0.99, at_least=True),
    "nominal_sequence_mix_ups": Ask(0, at_least=False),
    "scenes_looked_at": Ask(100, at_least=True),
}
TWINS = """
scene: bench/twins
materials:
  wood: {rgba: [0.86, 0.68, 0.48, 1]}
  red: {rgba: [0.82, 0.16, 0.14, 1]}
  blue: {rgba: [0.12, 0.33, 0.78, 1]}
bodies:
  table:
    kind: table
    fixed: true
    material: wood
    place: {position_m: [0.38, 0.05, -0.02]}
    shapes: [{kind: box, size_m: [0.52, 0.65, 0.02]}]
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
cameras:
  top: {position_m: [0.5, 0.05, 1.6], target_m: [0.501, 0.051, 0.0]}
lights:
  key: {position_m: [1.2, -1.2, 2.2], direction: [-0.4, 0.55, -1.0], diffuse: [0.65, 0.63, 0.6]}
"""


@dataclass(slots=True)
class Tally:
    """What one noise level came to."""

    position_mm: list[float] = field(default_factory=list)
    yaw_deg: list[float] = field(default_factory=list)
    tilt_deg: list[float] = field(default_factory=list)
    fixed_mm: list[float] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)
    things: int = 0
    missed: list[str] = field(default_factory=list)
    mixed_up: list[str] = field(default_factory=list)
    sequences: int = 0
    sequence_mix_ups: list[str] = field(default_factory=list)


class Stage:
    """One scene in a compiled model, with cameras and a belief."""

    def __init__(self, library: Library, scene: str, seed: int, sensors: Sensors, level: str) -> None:
        profile, folder = read_profile(library.get_target("panda"))
        spec = read_scene(library.get_scene(scene))
        self.physics = Physics.alone(profile, folder, spec, seed)
        self.physics.start(spec.settle_s)
        self._cameras = open_cameras(self.physics.model, sensors, seed=seed, level=level)
        noisy = sensors.get_noise(level).varies
        self.pipeline = Pipeline(build_inventory(spec), RobotMask(profile, folder), profile.target, noisy=noisy)
        self._scene = Scene(name=scene, seed=seed, episode="bench")
        self._rng = np.random.default_rng(seed)
        self.time_s, self.belief = 1.0, None
        self.ms: list[float] = []
        self.physics.look()
        self._state = self.physics.read_target({})

    def look(self, cameras: Sequence[str] = ()) -> Environment:
        """One look, through all cameras or some."""
        self.time_s += LOOK_S
        data = pose_state(self.physics.model, self.physics.data.qpos)
        frames = tuple(
            self._cameras[name].capture(data, self.time_s, self._rng) for name in cameras or tuple(self._cameras)
        )
        began_s = time.perf_counter()
        self.belief = self.pipeline.sense(Frames(frames), self._state, self._scene, self.time_s, self.belief)
        self.ms.append(1e3 * (time.perf_counter() - began_s))
        return self.belief

    def find(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and rotation (3, 3) of a body, as they are."""
        self.physics.look()
        body = self.physics.model.body(name).id
        return np.array(self.physics.seen.xpos[body]), np.array(self.physics.seen.xmat[body]).reshape(3, 3)

    def put(self, name: str, x_m: float, y_m: float, yaw_rad: float = 0.0) -> None:
        """Set a thing down somewhere."""
        model, data = self.physics.model, self.physics.data
        address = int(model.jnt_qposadr[model.body(name).jntadr[0]])
        data.qpos[address : address + 2] = x_m, y_m
        data.qpos[address + 3 : address + 7] = np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)


def score_scene(stage: Stage, name: str, tally: Tally) -> None:
    """Look, and compare every thing with where it is."""
    for _ in range(LOOKS):
        belief = stage.look()
    tally.ms += stage.ms
    things = stage.pipeline.inventory.things
    for thing in things.values():
        if thing.vessel is not None:
            continue  # the filling of a vessel is told as a whole
        entity = belief.entities.get(thing.name)
        position, rotation = stage.find(thing.name)
        is_found = entity is not None and entity.status is Status.SEEN
        if not thing.template.movable:
            if entity is not None:
                tally.fixed_mm.append(1e3 * measure_distance(entity, position))
            continue
        tally.things += 1
        if entity is None or not is_found:
            tally.missed.append(f"{name}: {thing.name}")
            continue
        score_pose(entity, thing, position, rotation, tally)
        if find_thief(entity, thing, things.values(), stage):
            tally.mixed_up.append(f"{name}: {thing.name}")


def score_pose(entity: Entity, thing: ObjectModel, position: np.ndarray, rotation: np.ndarray, tally: Tally) -> None:
    """Add one thing's errors."""
    tally.position_mm.append(1e3 * measure_distance(entity, position))
    believed = np.zeros(9)
    mujoco.mju_quat2Mat(believed, np.array(entity.pose.quaternion_wxyz))
    turns = [believed.reshape(3, 3) @ symmetry for symmetry in thing.symmetries]
    if thing.form is not Form.BALL:
        axis = [np.arccos(np.clip(turned[:, 2] @ rotation[:, 2], -1, 1)) for turned in turns]
        tally.tilt_deg.append(float(np.degrees(min(axis))))
    if thing.form is Form.BOX:
        angles = [np.arccos(np.clip((np.trace(turned.T @ rotation) - 1) / 2, -1, 1)) for turned in turns]
        tally.yaw_deg.append(float(np.degrees(min(angles))))


def find_thief(
    entity: Entity, thing: ObjectModel, things: Iterator[ObjectModel] | Sequence[ObjectModel], stage: Stage
) -> bool:
    """Whether a name is on another thing than its own."""
    own_m = measure_distance(entity, stage.find(thing.name)[0])
    others = [each.name for each in things if each.template.movable and each.name != thing.name and each.vessel is None]
    return own_m > MIXED_UP_M and any(measure_distance(entity, stage.find(each)[0]) < own_m for each in others)


def measure_distance(entity: Entity, position: np.ndarray) -> float:
    """Of a believed thing from a point [m]."""
    return float(np.linalg.norm(np.array(entity.pose.position_m) - position))


def run_sequences(library: Library, seed: int, sensors: Sensors, level: str, tally: Tally) -> None:
    """Two like cubes: one moved past the other in steps, then one hidden by a screen while the other moves."""
    stage = Stage(library, "bench/twins", seed, sensors, level)
    stage.look()
    real = match_names(stage)
    x_m, y_m = stage.find(real["first"])[0][:2]
    for step in range(1, 9):
        stage.put(real["first"], x_m + 0.075, y_m + 0.02 * step * np.sign(-y_m), yaw_rad=0.1 * step)
        stage.look()
        count_names(stage, real, f"seed {seed}, passing by, step {step}", tally)
    stage = Stage(library, "bench/twins", seed, sensors, level)
    stage.look()
    real = match_names(stage)
    hidden, moving = ("first", "second") if stage.find(real["first"])[0][1] > 0 else ("second", "first")
    place = stage.find(real[hidden])[0]
    stage.put("screen", *(place[:2] + 0.12 * np.array((0.6, -0.8))), yaw_rad=-0.93)
    stage.look(("right",))
    for y_m in (-0.08, -0.12, -0.16):
        stage.put(real[moving], 0.46, y_m)
        stage.look(("right",))
        count_names(stage, real, f"seed {seed}, behind a screen, {y_m}", tally)
    stage.put("screen", 0.3, 0.35)
    stage.put(real[hidden], place[0] - 0.03, place[1])
    stage.look()
    count_names(stage, real, f"seed {seed}, shown again", tally)


def match_names(stage: Stage) -> dict[str, str]:
    """Which of the like cubes each name was given to at first: nothing tells them apart but this."""
    belief = stage.belief
    bodies = ("first", "second")
    if belief is None or any(name not in belief.entities for name in bodies):
        return dict(zip(bodies, bodies, strict=True))
    straight = sum(measure_distance(belief.entities[name], stage.find(name)[0]) for name in bodies)
    crossed = sum(
        measure_distance(belief.entities[a], stage.find(b)[0]) for a, b in zip(bodies, bodies[::-1], strict=True)
    )
    return dict(zip(bodies, bodies if straight <= crossed else bodies[::-1], strict=True))


def count_names(stage: Stage, real: dict[str, str], what: str, tally: Tally) -> None:
    """One association to be judged for each name."""
    tally.sequences += 1
    for name, body in real.items():
        entity = stage.belief.entities.get(name) if stage.belief is not None else None
        if entity is None or measure_distance(entity, stage.find(body)[0]) > MIXED_UP_M:
            tally.sequence_mix_ups.append(f"{what}: {name}")


def show(console: Console, tallies: dict[str, Tally], scenes: int) -> None:
    """The table, and what went wrong."""
    table = Table(title=f"the embedded pipeline on {scenes} scenes, median / 95th percentile")
    for column in ("", *tallies):
        table.add_column(column)
    rows = {
        "position (mm)": "position_mm",
        "turn of boxes (deg)": "yaw_deg",
        "tilt (deg)": "tilt_deg",
        "position of fixed things (mm)": "fixed_mm",
        "one look, without the cameras (ms)": "ms",
    }
    for title, name in rows.items():
        spreads = [Spread.of(getattr(tally, name)) for tally in tallies.values()]
        table.add_row(title, *(f"{spread.median:.2f} / {spread.p95:.2f}  ({spread.count})" for spread in spreads))
    table.add_row("movable things not found", *(f"{len(t.missed)} of {t.things}" for t in tallies.values()))
    table.add_row("names on other things", *(f"{len(t.mixed_up)} of {t.things}" for t in tallies.values()))
    table.add_row(
        "the same, in sequences", *(f"{len(t.sequence_mix_ups)} of {2 * t.sequences}" for t in tallies.values())
    )
    console.print(table)
    for level, tally in tallies.items():
        for text in (*tally.missed[:8], *tally.mixed_up[:8], *tally.sequence_mix_ups[:8]):
            console.print(f"{level}: {text}", style="dim")


def main() -> int:
    """Run, show, and exit with whether every asked figure holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12, help="of each scene")
    parser.add_argument("--levels", nargs="+", default=["none", "nominal", "harsh"])
    given = parser.parse_args()
    sensors = read_sensors(ROOT / "protocol" / "sensors.yaml")
    scenes = sorted(path.stem for path in (ROOT / "scenes" / "tabletop").glob("*.yaml"))
    tallies = {level: Tally() for level in given.levels}
    with tempfile.TemporaryDirectory(prefix="perception-") as scratch:
        (Path(scratch) / "scenes" / "bench").mkdir(parents=True)
        (Path(scratch) / "scenes" / "bench" / "twins.yaml").write_text(TWINS)
        library = Library.open(Path(scratch))
        for level, tally in tallies.items():
            for seed in range(given.seeds):
                for name in scenes:
                    stage = Stage(library, f"tabletop/{name}", seed, sensors, level)
                    score_scene(stage, f"{name}, seed {seed}", tally)
                run_sequences(library, seed, sensors, level, tally)
    show(Console(), tallies, given.seeds * len(scenes))
    figures = {"scenes_looked_at": float(given.seeds * len(scenes))}
    for level, tally in tallies.items():
        spread, turns = Spread.of(tally.position_mm), Spread.of(tally.yaw_deg)
        figures |= {
            f"{level}_position_mm_median": spread.median,
            f"{level}_position_mm_p95": spread.p95,
            f"{level}_yaw_deg_median": turns.median,
            f"{level}_yaw_deg_p95": turns.p95,
            f"{level}_tilt_deg_p95": Spread.of(tally.tilt_deg).p95,
            f"{level}_found": 1.0 - len(tally.missed) / max(tally.things, 1),
            f"{level}_mix_ups": float(len(tally.mixed_up)),
            f"{level}_sequence_mix_ups": float(len(tally.sequence_mix_ups)),
        }
    line, holds = format_outcome(figures, ASKED)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
