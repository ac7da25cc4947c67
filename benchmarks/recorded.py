"""Legitimate commands: `tidy_table` run in one process, with every command kept as it went over the wire."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.session import Ended, Scene
from phyagentos.protocol.settings.safety import TargetLimits, read_safety
from phyagentos.protocol.world.environment import Entity
from phyagentos.protocol.world.faults import FaultFile
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector, draw_schedule
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.testing import SkillStand, make_contract

CUBES = ("red", "green", "blue")


@dataclass(frozen=True, slots=True)
class Recording:
    """One session as the target saw it.

    Attributes:
        commands: In order, each with the step that stood before it.
        q_rad: Where the arm rested when the session began.
        entities: The world as it was then.
        ended: How the execution ended.
    """

    description: wire.Description
    commands: tuple[tuple[wire.Command, wire.Step], ...]
    q_rad: tuple[float, ...]
    entities: tuple[Entity, ...]
    ended: Ended


@dataclass(frozen=True, slots=True)
class Robot:
    """What the recordings were made with."""

    profile: TargetProfile
    folder: Path
    limits: TargetLimits
    library: Library


class TappedTarget:
    """A simulated world in this process that keeps what it is asked in a session."""

    def __init__(self, robot: Robot, faults: FaultFile) -> None:
        world = SimulatedWorld(robot.library, faults=lambda *episode: FaultInjector(draw_schedule(faults, *episode)))
        self._target = ServedTarget(MujocoDriver(world, robot.profile, robot.folder), ReceiveLog(None))
        self.close = self._target.close
        self.commands: list[wire.Command] = []
        self.steps: list[wire.Step] = []
        self.observation: wire.Observation | None = None

    def handle(self, request: wire.Request) -> Any:
        """Its reply, kept where it is of a command or the first observation of a session."""
        reply = self._target.handle(request)
        if isinstance(request, wire.Command):
            self.commands.append(request)
            self.steps.append(reply)
        elif isinstance(request, wire.Begin):
            self.commands, self.steps, self.observation = [], [], None
        elif isinstance(reply, wire.Observation) and self.observation is None:
            self.observation = reply
        return reply


@contextmanager
def open_stand(robot: Robot, planner: LocalPlanner, faults: FaultFile, folder: Path) -> Iterator[SkillStand]:
    """A stand for sessions in a simulated world, whose bundles go below the folder."""
    target: Any = TappedTarget(robot, faults)
    with closing(target):
        how: dict[str, Any] = {"planner": planner, "library": robot.library, "robot": (robot.profile, robot.limits)}
        yield SkillStand(folder, target=target, clock=SystemClock(), **how)


def open_robot(target: str = "panda") -> Robot:
    """A shipped robot with the shipped limits."""
    library = Library.open()
    profile, folder = read_profile(library.get_target(target))
    own = folder / "safety.yaml"
    limits = read_safety(own if own.exists() else find_shipped_root() / "protocol" / "safety.yaml").targets[target]
    return Robot(profile, folder, limits, library)


def record_tidy_table(
    robot: Robot, seeds: Sequence[int], faults: FaultFile | None = None, planner: LocalPlanner | None = None
) -> list[Recording]:
    """Three sessions a seed: each cube into its tray.

    Args:
        robot: Who does it.
        seeds: Of the scenes.
        faults: What strikes; nothing when None.
        planner: Of the robot's motions; one of its own when None.
    """
    planner = planner or LocalPlanner(MotionPlanner(robot.profile, robot.folder))
    recordings = []
    for seed in seeds:
        recordings += _record_seed(robot, planner, seed, faults or FaultFile(version=1))
    return recordings


def _record_seed(robot: Robot, planner: LocalPlanner, seed: int, faults: FaultFile) -> list[Recording]:
    recordings = []
    with (
        tempfile.TemporaryDirectory() as folder,
        open_stand(robot, planner, faults, Path(folder)) as stand,
    ):
        for number, color in enumerate(CUBES):
            session = make_contract(
                id=f"tidy-{seed}.{color}",
                goal=f"tidy-{seed}",
                node=color,
                objective=f"Put the {color} cube into the {color} tray.",
                target=robot.profile.target,
                parameters={"object": f"{color}_cube", "destination": f"{color}_tray"},
                scene=Scene(name="tabletop/cubes_and_trays", seed=seed, episode=f"tidy-{seed}"),
                seed=10 * seed + number,
            )
            recordings.append(_keep(stand, stand.run(session).ended))
    return recordings


def _keep(stand: SkillStand, ended: Ended) -> Recording:
    tap: Any = stand.target
    seen = tap.observation
    assert seen is not None
    first = wire.Step(time_s=seen.time_s, target=seen.target, tracking_error_rad=0.0)
    before = (first, *tap.steps)[: len(tap.commands)]
    return Recording(
        description=stand.handle.describe(),
        commands=tuple(zip(tap.commands, before, strict=True)),
        q_rad=seen.target.q_rad,
        entities=seen.entities,
        ended=ended,
    )
