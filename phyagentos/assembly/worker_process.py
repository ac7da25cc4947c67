"""The worker process of one target, put together: what defines it, its access to the body, its runner and examiner."""

import argparse
import gc
import signal
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

from phyagentos.assembly.drivers import choose_driver
from phyagentos.assembly.process_tuning import ask_for_precedence, collect_rarely
from phyagentos.assembly.processes import ending_by_errors, make_command
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import locate_models, read_skill_registry, read_target_registry
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.predicates.project_predicates import load_predicates
from phyagentos.protocol.sessions.estop import is_latched
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.settings.safety import TargetLimits, as_numbers
from phyagentos.protocol.settings.sensors import WORLD
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.actions.collision import PostureCollision
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.channel import Channel, Link, connect
from phyagentos.runtime.execution.leaf_registry import LeafRegistry, build_registry
from phyagentos.runtime.lookahead.gate import LookaheadGate
from phyagentos.runtime.lookahead.service import RehearsalProcess
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.motion.process import LocalPlanner, NoModel, Planner, PlannerProcess
from phyagentos.runtime.motion.tool_bounds import read_tool_bounds
from phyagentos.runtime.perception.look import FrameSource
from phyagentos.runtime.perception.world_model import GroundTruthWorldModel, WorldModel
from phyagentos.runtime.policies.client import ask_policy
from phyagentos.runtime.policies.policy_runtime import Policies
from phyagentos.runtime.preflight.compatibility import Preflight
from phyagentos.runtime.preflight.examination import Examiner
from phyagentos.runtime.preflight.settings import Settings, read_settings
from phyagentos.runtime.supervision.workers import end_with_parent
from phyagentos.runtime.targets.driver_registry import DriverSite
from phyagentos.runtime.targets.handshake import greet
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback
from phyagentos.runtime.worker.embodiment import Embodiment, SkillLoader
from phyagentos.runtime.worker.heartbeat import HeartbeatWriter
from phyagentos.runtime.worker.orders import serve_refusals
from phyagentos.runtime.worker.recorder import Bundles
from phyagentos.runtime.worker.runner import SessionRunner
from phyagentos.runtime.worker.worker import WorkerLoop

WORLD_START_S = 60.0  # a cold machine imports and compiles once


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerSite:
    """The definitions that a worker works by; `local` serves a target that has no process of its own."""

    workspace: Workspace
    target: str
    clock: Clock
    library: Library
    targets: Mapping[str, TargetProfile]
    skills: dict[str, SkillRuntime]
    settings: Settings
    registry: LeafRegistry
    local: ServedTarget | None

    @property
    def profile(self) -> TargetProfile:
        """Of its target, as TARGETS.md has it."""
        return self.targets[self.target]

    @property
    def model(self) -> Path:
        """The target's own description."""
        return self.library.get_target(self.target)


def run_worker(root: Path, target: str, socket: str, control: int, *, pictures: bool, rehearsal: Sequence[str]) -> None:
    """The worker process of one target: serve the watchdog until it is gone; `rehearsal` starts a rehearsal process."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the watchdog ends it: an interrupt is of a person's code
    workspace, clock = Workspace.open(root), SystemClock()
    orders = Link(Connection(control), spin_s=0.0)
    token = orders.recv_bytes()
    try:
        site = read_site(workspace, target, clock)
    except DefinitionError as error:
        serve_refusals(orders, error.problems)
        return
    planner = open_planner(site)
    body = open_body(site, socket, token)
    runner = build_runner(site, body, planner, pictures=pictures)
    gate = LookaheadGate(forecasts=RehearsalProcess(rehearsal), world=body.world, evidence=workspace.evidence)
    collect_rarely()
    if site.settings.contract.world_mode is WorldMode.REALTIME:
        ask_for_precedence()
    WorkerLoop(
        control=orders,
        target=body,
        examiner=build_examiner(site, body, planner, runner),
        runner=runner,
        heartbeat=HeartbeatWriter(workspace.heartbeats, target, clock),
        workspace=workspace,
        clock=clock,
        gate=gate,
    ).run()
    gate.close()
    planner.close()


def read_site(workspace: Workspace, target: str, clock: Clock) -> WorkerSite:
    """Read the definitions of a target, and open its driver where it has no process of its own; DefinitionError."""
    library = workspace.library()
    load_predicates(library.iter_predicates())
    targets = read_target_registry(workspace.target_registry)
    spec = choose_driver(targets, target)
    skills = locate_models(read_skill_registry(workspace.skill_registry), library)
    settings, registry, local = read_settings(workspace, target), build_registry(library), None
    if not spec.own_process:
        folder = library.get_target(target).parent
        driver = spec.open(DriverSite(profile=targets[target], folder=folder, workspace=workspace, clock=clock))
        log = ReceiveLog(workspace.logs / f"receive-{target}.jsonl", clock)
        local = ServedTarget(driver, log, is_estopped=partial(is_latched, workspace.signals.parent))
    return WorkerSite(
        workspace=workspace,
        target=target,
        clock=clock,
        library=library,
        targets=targets,
        skills=skills,
        settings=settings,
        registry=registry,
        local=local,
    )


def open_planner(site: WorkerSite) -> Planner:
    """The planner of the target's motions, in a process of its own; without a model it plans none."""
    profile = site.profile
    if not profile.model:
        return LocalPlanner(NoModel())
    shared = {name for name, each in site.targets.items() if profile.world and each.world == profile.world}
    neighbours = {name: site.library.get_target(name) for name in sorted(shared - {site.target})}
    return PlannerProcess(site.model, read_tool_bounds(site.settings.limits), neighbours, site.settings.contract.speed)


def open_body(site: WorkerSite, socket: str, token: bytes) -> Embodiment:
    """The worker's access to its target, and the model of the world around it."""
    profile, settings = site.profile, site.settings
    connection: Channel = (
        Loopback(site.local) if site.local is not None else connect_to_world(socket, token, site.clock)
    )
    has_truth = not profile.model and profile.kind != "real_robot"
    sees_truth = settings.perception.sensing is Sensing.TRUTH or has_truth
    handle = open_handle(connection, settings.limits, site.workspace, site.model, sees_truth=sees_truth)
    world = open_world_model(site.workspace, site.target, profile, handle, settings)
    return Embodiment(handle=handle, world=world, profile=profile, limits=settings.limits)


def build_runner(site: WorkerSite, body: Embodiment, planner: Planner, *, pictures: bool) -> SessionRunner:
    """What carries out a session and records it."""
    workspace, settings = site.workspace, site.settings
    policies = Policies(
        skills=site.skills,
        profile=site.profile,
        sensors=settings.sensors,
        handle=body.handle,
        late_max_s=settings.perception.embedded.max_age_s,
        is_realtime=settings.contract.world_mode is WorldMode.REALTIME,
    )
    in_force = (workspace.safety, workspace.sensors, workspace.perception, workspace.runtime_contract)
    return SessionRunner(
        target=body,
        skills=SkillLoader(
            planner=planner,
            library=site.library,
            registry=site.registry,
            policies=policies,
            skills=site.skills,
            loops=workspace.loops,
        ),
        bundles=Bundles(workspace.root, settings=in_force, pictures=pictures),
        clock=site.clock,
        sampling_hz=settings.contract.sampling_hz,
        record=settings.contract.record,
    )


def build_examiner(site: WorkerSite, body: Embodiment, planner: Planner, runner: SessionRunner) -> Examiner:
    """What checks a session before it starts."""
    return Examiner(
        preflight=Preflight(skills=site.skills, profile=site.profile, settings=site.settings, ask_policy=ask_policy),
        handle=body.handle,
        world=body.world,
        planner=planner,
        library=site.library,
        registry=site.registry,
        clock=site.clock,
        show_look=runner.bundles.show,
    )


def open_world_model(
    workspace: Workspace, target: str, profile: TargetProfile, handle: FrameSource, settings: Settings
) -> WorldModel:
    """What perception.yaml chooses; without a model the robot cannot be masked in pictures.

    A real robot without a camera perceives itself, and nothing else.
    """
    if profile.kind == "real_robot" and not settings.sensors.cameras:
        return GroundTruthWorldModel(target, handle, sensing="perceived", profile=profile)
    if settings.perception.sensing is Sensing.TRUTH or not profile.model:
        return GroundTruthWorldModel(target, handle, profile=profile)
    from phyagentos.runtime.perception.detection.detector_registry import open_detector
    from phyagentos.runtime.perception.perceived_world import PerceivedWorld
    from phyagentos.runtime.perception.robot_mask import RobotMask

    library, chosen = workspace.library(), settings.perception.detector
    address = "perception.yaml: detector.name"
    cameras = settings.sensors.cameras.items()
    return PerceivedWorld(
        target,
        handle,
        library,
        RobotMask(profile, library.get_target(target).parent),
        moving=[name for name, sensor in cameras if sensor.camera is not None and sensor.camera.mount != WORLD],
        max_age_s=settings.perception.embedded.max_age_s,
        detector=open_detector(chosen.name, chosen.settings, address) if chosen is not None else None,
        noisy=settings.sensors.get_noise().varies,
        prior=settings.perception.prior,
        profile=profile,
    )


def open_handle(
    connection: Channel, limits: TargetLimits, workspace: Workspace, description: Path, *, sees_truth: bool = False
) -> TargetSessionHandle:
    """The worker's access to its target; its guard checks the emergency stop before every command.

    Postures are tested on the robot of its own `description`; preflight compares that with TARGETS.md.
    """
    signals, limit = workspace.signals.parent, limits.collision_depth_max
    collision = None
    if limit is not None:
        collision = PostureCollision(*read_profile(description), min(as_numbers(limit)))
    return TargetSessionHandle(
        connection, limits, is_stopped=lambda: is_latched(signals), collision=collision, sees_truth=sees_truth
    )


def connect_to_world(socket: str, token: bytes, clock: Clock) -> Link:
    """The connection to a world process that may still be starting, opened with the token of this worker.

    Raises ExecutionError `TARGET_LOST` unless it is served within the start-up time; `NOT_SECURED`, `VERSION_MISMATCH`.
    """
    deadline_s = clock.now_s() + WORLD_START_S
    while True:
        try:
            link = Link(connect(socket))
            greet(link, token)
            return link
        except (FileNotFoundError, ConnectionRefusedError) as error:
            if clock.now_s() > deadline_s:
                raise ExecutionError("TARGET_LOST", f"no world listens at {socket}") from error
            clock.sleep(0.02)


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of a worker."""
    parser = argparse.ArgumentParser(prog="phyagentos.assembly.worker_process")
    parser.add_argument("--workspace", type=Path, required=True)
    parser.add_argument("--target", required=True)
    parser.add_argument("--socket", required=True)
    parser.add_argument("--control", type=int, required=True)
    parser.add_argument("--no-pictures", action="store_true")
    given = parser.parse_args(argv)
    rehearsal = make_command("rehearsal", given.workspace.resolve(), given.target)
    with ending_by_errors():
        run_worker(
            given.workspace,
            given.target,
            given.socket,
            given.control,
            pictures=not given.no_pictures,
            rehearsal=rehearsal,
        )


if __name__ == "__main__":
    gc.disable()  # until all is loaded: a sixth of a start
    main()
