"""The composition root: builds one process of one plane from one workspace. Nothing else calls concrete constructors.

`python -m phyagentos.assembly world|worker ...` are the runtime's own children; people start the planes with `paos`.
"""

import argparse
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Client, Connection
from pathlib import Path
from types import FrameType
from typing import Any

from phyagentos.agent.mission import Mission
from phyagentos.agent.mission_report import MissionReport
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.journal import Journal
from phyagentos.protocol.library import Library
from phyagentos.protocol.lifecycle import Side
from phyagentos.protocol.settings import get_target_limits, read_safety
from phyagentos.protocol.views import Views, read_skill_registry, read_target_registry
from phyagentos.protocol.workspace import Workspace

WORLD_START_S = 60.0  # a cold machine imports and compiles once
FAULTS = Path(".world") / "faults.yaml"  # read by the world process only


def open_project(root: Path, *projects: Path) -> Workspace:
    """The workspace at `root`, made from the given project folders and what ships, when it does not stand yet."""
    return Workspace.create(root, Library.open(*projects, Path.cwd()))


def run_watch(root: Path, *, faults: Path | None = None, pictures: bool = True, once_idle: bool = False) -> None:
    """The runtime plane: supervise until interrupted.

    Args:
        root: The workspace.
        faults: Fault file for the simulated worlds.
        pictures: Whether evidence has pictures.
        once_idle: End when every goal has its verdict.
    """
    from phyagentos.runtime.watchdog import Watchdog
    from phyagentos.runtime.workers import Worker

    workspace, clock = open_project(root), SystemClock()
    if faults is not None:
        (workspace.root / FAULTS).parent.mkdir(exist_ok=True)
        shutil.copyfile(faults, workspace.root / FAULTS)
    journal = Journal(workspace.root, side=Side.RUNTIME, by="watchdog", clock=clock)
    views = Views(workspace, journal.folder, clock)
    known = read_target_registry(workspace.target_registry)

    with tempfile.TemporaryDirectory(prefix="paos-") as sockets:

        def hire(target: str) -> Worker | None:
            if target not in known:
                return None
            place = ["--workspace", str(workspace.root), "--target", target, "--socket", f"{sockets}/{target}.world"]
            return Worker(
                target,
                world=["-m", "phyagentos.assembly", "world", *place],
                worker=["-m", "phyagentos.assembly", "worker", *place, *([] if pictures else ["--no-pictures"])],
                logs=workspace.logs,
            )

        def publish() -> None:
            views.refresh()
            goals = views.ledger.goals.values()
            if once_idle and goals and all(goal.verdict or goal.is_cancelled for goal in goals):
                watchdog.stop()

        watchdog = Watchdog(workspace=workspace, journal=journal, hire=hire, clock=clock, publish=publish)

        def on_signal(_number: int, _frame: FrameType | None) -> None:
            watchdog.stop()

        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, on_signal)
        watchdog.run()
    views.close()
    journal.close()


def run_agent(root: Path, graph: Path, seed: int, *, overrides: Mapping[str, str] | None = None) -> MissionReport:
    """The agent plane: pursue one goal to its verdict; continues it when the workspace already knows it.

    Args:
        root: The workspace.
        graph: The goal graph.
        seed: Root of every random choice.
        overrides: Dotted path -> YAML value (`targets.arm` -> `panda`).
    """
    clock = SystemClock()
    workspace = open_project(root, find_project(graph))
    journal = Journal(workspace.root, side=Side.AGENT, by="agent", clock=clock)
    mission = Mission(workspace, journal, clock=clock)

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        mission.cancel()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, on_signal)
    try:
        return mission.run(graph, seed=seed, overrides=overrides)
    finally:
        journal.close()


def find_project(graph: Path) -> Path:
    """The project folder that a goal graph belongs to: the parent of its `goal_graphs/`, else its own folder."""
    folder = graph.resolve().parent
    return folder.parent if folder.name == "goal_graphs" else folder


def run_world(root: Path, target: str, socket: str) -> None:
    """The world process of one target: simulate until the watchdog is gone."""
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")  # read by MuJoCo when it is imported
    from phyagentos.protocol.faults import read_faults
    from phyagentos.runtime.targets.faults import FaultInjector, Schedule, draw_schedule
    from phyagentos.runtime.targets.receive_log import ReceiveLog
    from phyagentos.runtime.targets.robot import read_profile
    from phyagentos.runtime.targets.server import serve
    from phyagentos.runtime.targets.world import MujocoWorld
    from phyagentos.runtime.workers import end_with_parent

    end_with_parent()
    workspace = Workspace.open(root)
    library = workspace.library()
    profile, folder = read_profile(library.get_target(target))
    path = workspace.root / FAULTS
    file = read_faults(path) if path.exists() else None

    def make_faults(episode: str, seed: int) -> FaultInjector:
        return FaultInjector(draw_schedule(file, episode, seed) if file is not None else Schedule())

    log = ReceiveLog(workspace.logs / f"receive-{target}.jsonl")
    serve(MujocoWorld(profile, folder, library, log, make_faults), socket)


def run_worker(root: Path, target: str, socket: str, control: int, *, pictures: bool) -> None:
    """The worker process of one target: serve the watchdog until it is gone."""
    from phyagentos.runtime.execution.registry import build_registry
    from phyagentos.runtime.handle import TargetSessionHandle
    from phyagentos.runtime.heartbeat import HeartbeatWriter
    from phyagentos.runtime.motion.process import PlannerProcess
    from phyagentos.runtime.perception import TruthPerception
    from phyagentos.runtime.preflight import Preflight
    from phyagentos.runtime.runner import SessionRunner
    from phyagentos.runtime.worker import WorkerLoop
    from phyagentos.runtime.workers import end_with_parent

    end_with_parent()
    workspace, clock = Workspace.open(root), SystemClock()
    library = workspace.library()
    profile_path = library.get_target(target)
    profile = read_target_registry(workspace.target_registry)[target]
    limits = get_target_limits(read_safety(workspace.safety), target, str(workspace.safety))
    planner = PlannerProcess(profile_path)
    registry = build_registry(library)
    handle = TargetSessionHandle(connect_to_world(socket, clock), limits)
    perception = TruthPerception(target)
    runner = SessionRunner(
        handle=handle,
        planner=planner,
        perception=perception,
        registry=registry,
        library=library,
        profile=profile,
        limits=limits,
        workspace=workspace.root,
        clock=clock,
        settings=(workspace.safety, workspace.sensors, workspace.perception, workspace.runtime_contract),
        pictures=pictures,
    )
    WorkerLoop(
        control=Connection(control),
        handle=handle,
        preflight=Preflight(skills=read_skill_registry(workspace.skill_registry), profile=profile),
        runner=runner,
        perception=perception,
        heartbeat=HeartbeatWriter(workspace.heartbeats, target, clock),
        library=library,
        registry=registry,
        workspace=workspace,
    ).run()
    planner.close()


def connect_to_world(socket: str, clock: Clock) -> "Connection[Any, Any]":
    """The connection to a world process that may still be starting.

    Raises:
        ExecutionError: `TARGET_LOST` when nobody listens within the start-up time.
    """
    deadline_s = clock.now_s() + WORLD_START_S
    while True:
        try:
            return Client(socket, "AF_UNIX")
        except (FileNotFoundError, ConnectionRefusedError) as error:
            if clock.now_s() > deadline_s:
                raise ExecutionError("TARGET_LOST", f"no world listens at {socket}") from error
            clock.sleep(0.02)


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the runtime's own child processes."""
    parser = argparse.ArgumentParser(prog="phyagentos.assembly")
    parser.add_argument("process", choices=("world", "worker"))
    parser.add_argument("--workspace", type=Path, required=True)
    parser.add_argument("--target", required=True)
    parser.add_argument("--socket", required=True)
    parser.add_argument("--control", type=int, default=-1)
    parser.add_argument("--no-pictures", action="store_true")
    given = parser.parse_args(argv)
    try:
        if given.process == "world":
            run_world(given.workspace, given.target, given.socket)
        else:
            run_worker(given.workspace, given.target, given.socket, given.control, pictures=not given.no_pictures)
    except DefinitionError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
