"""Legitimate commands: `tidy_table` run in one process, with every command kept as it went over the wire."""

import tempfile
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.session import Ended, Execution, GoalId, Limits, Scene, Session, SessionId
from phyagentos.protocol.settings.safety import TargetLimits, read_safety
from phyagentos.protocol.world.environment import Entity
from phyagentos.protocol.world.faults import FaultFile
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector, draw_schedule
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.perception.world_model import GroundTruthWorldModel
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.worker.embodiment import Embodiment, SkillLoader
from phyagentos.runtime.worker.recorder import Bundles
from phyagentos.runtime.worker.runner import SessionRunner

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


class TappedConnection:
    """Both ends of the wire in one process; keeps what passes."""

    def __init__(self, target: ServedTarget) -> None:
        self._target = target
        self._replies: deque[bytes] = deque()
        self.commands: list[wire.Command] = []
        self.steps: list[wire.Step] = []
        self.observation: wire.Observation | None = None

    def send_bytes(self, message: bytes) -> None:
        """Carry a request out at once."""
        request = wire.REQUESTS.decode(message)
        reply = self._target.handle(request)
        if isinstance(request, wire.Command):
            self.commands.append(request)
            self.steps.append(reply)
        elif isinstance(request, wire.Begin):
            self.commands, self.steps, self.observation = [], [], None
        elif isinstance(reply, wire.Observation) and self.observation is None:
            self.observation = reply
        self._replies.append(wire.REPLIES.encode(reply))

    def recv_bytes(self) -> bytes:
        """The reply."""
        return self._replies.popleft()

    def poll(self, _timeout: float | None = None) -> bool:
        """Whether there is one."""
        return bool(self._replies)


def open_robot(target: str = "panda", *projects: Path) -> Robot:
    """The shipped robot with the shipped limits; scenes also of other projects."""
    library = Library.open(*projects)
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


@contextmanager
def open_runner(
    robot: Robot, planner: LocalPlanner, faults: FaultFile, folder: Path
) -> Iterator[tuple[SessionRunner, TargetSessionHandle, TappedConnection]]:
    """The ordinary runner with its handle and a simulated world, in this process; bundles go below the folder."""
    simulated = SimulatedWorld(robot.library, faults=lambda *episode: FaultInjector(draw_schedule(faults, *episode)))
    world = ServedTarget(MujocoDriver(simulated, robot.profile, robot.folder), ReceiveLog(None))
    tap = TappedConnection(world)
    handle = TargetSessionHandle(tap, robot.limits, sees_truth=True)
    runner = SessionRunner(
        target=Embodiment(
            handle=handle,
            world=GroundTruthWorldModel(robot.profile.target, handle),
            profile=robot.profile,
            limits=robot.limits,
        ),
        skills=SkillLoader(planner=planner, library=robot.library, registry=build_registry(robot.library)),
        bundles=Bundles(folder),
        clock=SystemClock(),
    )
    try:
        yield runner, handle, tap
    finally:
        world.close()


def carry_out(runner: SessionRunner, handle: TargetSessionHandle, session: Session) -> Execution:
    """One session in its scene, which is loaded before."""
    handle.load(session.scene)
    how: dict[str, Any] = {"cancel": lambda: None, "beat": lambda **_beat: None}
    return runner.run(session, 1, {"tree": session.skill}, evidence=f"evidence/{session.id}", **how)


def _record_seed(robot: Robot, planner: LocalPlanner, seed: int, faults: FaultFile) -> list[Recording]:
    recordings = []
    with (
        tempfile.TemporaryDirectory() as folder,
        open_runner(robot, planner, faults, Path(folder)) as (runner, handle, tap),
    ):
        for number, color in enumerate(CUBES):
            execution = carry_out(runner, handle, _make_session(robot.profile.target, seed, number, color))
            recordings.append(_keep(tap, handle, execution.ended))
    return recordings


def _make_session(target: str, seed: int, number: int, color: str) -> Session:
    return Session(
        id=SessionId(f"tidy-{seed}.{color}"),
        goal=GoalId(f"tidy-{seed}"),
        node=color,
        objective=f"Put the {color} cube into the {color} tray.",
        skill="pick_and_place",
        target=target,
        parameters={"object": f"{color}_cube", "destination": f"{color}_tray"},
        accept=(),
        scene=Scene(name="tabletop/cubes_and_trays", seed=seed, episode=f"tidy-{seed}"),
        seed=10 * seed + number,
        limits=Limits(),
    )


def _keep(tap: TappedConnection, handle: TargetSessionHandle, ended: Ended) -> Recording:
    seen = tap.observation
    assert seen is not None
    first = wire.Step(time_s=seen.time_s, target=seen.target, tracking_error_rad=0.0)
    before = (first, *tap.steps)[: len(tap.commands)]
    return Recording(
        description=handle.describe(),
        commands=tuple(zip(tap.commands, before, strict=True)),
        q_rad=seen.target.q_rad,
        entities=seen.entities,
        ended=ended,
    )
