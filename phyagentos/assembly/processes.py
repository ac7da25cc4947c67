"""The runtime's own child processes, started by the watchdog: a world, a worker and a rehearsal for each target."""

import argparse
import gc
import sys
import threading
from collections.abc import Mapping, Sequence
from functools import partial
from multiprocessing.connection import Client, Connection
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from phyagentos.assembly.drivers import DRIVERS, choose_driver, choose_graphics, open_shared_world
from phyagentos.assembly.process_tuning import ask_for_precedence, collect_rarely
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.registries import locate_models, read_skill_registry, read_target_registry
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.estop import is_latched
from phyagentos.protocol.settings.perception import Sensing, read_perception
from phyagentos.protocol.settings.safety import TargetLimits, as_numbers
from phyagentos.protocol.settings.sensors import WORLD
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.channel import SPIN_S, Channel, Link
from phyagentos.runtime.targets.driver_registry import DriverSite, find_driver
from phyagentos.runtime.targets.handshake import Tokens, greet

if TYPE_CHECKING:
    from phyagentos.runtime.actions.handle import TargetSessionHandle
    from phyagentos.runtime.perception.look import FrameSource
    from phyagentos.runtime.perception.world_model import WorldModel
    from phyagentos.runtime.preflight.settings import Settings
    from phyagentos.runtime.targets.server import Door

WORLD_START_S = 60.0  # a cold machine imports and compiles once


def make_command(process: str, root: Path, target: str, *options: str) -> list[str]:
    """Arguments of the interpreter that start one of these processes."""
    place = ["--workspace", str(root), "--target", target]
    return ["-m", "phyagentos.assembly.processes", process, *place, *options]


def run_world(root: Path, world: str, socket: str, *, outlives: bool, certificate: Path | None = None) -> None:
    """The process of one world, and of every target in it, until its supervisor ends.

    A world that is not shared has the name of its only target, which listens at `socket`: the path of a UNIX socket, or
    `ws://host:port`, with a `certificate` `wss://host:port`, for commanders of another workspace. Targets that share a
    world listen beside that path, each at `<target>.world`. With `outlives`, it waits for another watchdog when the
    process that started it dies.

    Raises:
        ExecutionError: `TARGET_BUSY` when another one lives.
        DefinitionError: `NO_DRIVER`, `WORLD_NOT_SHARED`, `NOT_ENCRYPTED`, or problems of the targets' profiles.
    """
    from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, become_sole, is_held_by
    from phyagentos.runtime.supervision.workers import end_with_parent
    from phyagentos.runtime.supervision.world_process import end_when_unwatched, get_lock

    workspace, clock = Workspace.open(root), SystemClock()
    become_sole(get_lock(workspace.root, world), clock, "TARGET_BUSY", f"another world process has {world}")
    choose_graphics()
    sites = find_sites(workspace, world, clock)
    is_supervisor = partial(is_held_by, workspace.root / WATCHDOG_LOCK)
    tokens = {site.profile.target: Tokens(is_supervisor=is_supervisor) for site in sites}

    def renew_key(line: bytes) -> None:
        name, key, *commander = line.decode().split()
        if name in tokens:
            tokens[name].renew(bytes.fromhex(key), *map(int, commander))

    if outlives:
        end_when_unwatched(workspace.root, clock, renew_key)
    else:
        end_with_parent(renew_key)
    from phyagentos.protocol.settings.runtime_contract import WorldMode, read_runtime_contract

    pace_by = clock if read_runtime_contract(workspace.runtime_contract).world_mode is WorldMode.REALTIME else None
    if pace_by is not None:
        ask_for_precedence()
    if len(sites) == 1:
        serve_one(sites[0], socket, tokens[sites[0].profile.target], pace_by, certificate)
    else:
        serve_shared(sites, Path(socket).parent, tokens, pace_by)


def find_sites(workspace: Workspace, world: str, clock: Clock) -> list[DriverSite]:
    """The targets of a world, by name: those that name it, or the one of that name that shares none."""
    from phyagentos.runtime.models.robot import read_profile

    library = workspace.library()
    found = [read_profile(library.get_target(name)) for name in sorted(library.names_of_targets())]
    return [
        DriverSite(profile=profile, folder=folder, workspace=workspace, clock=clock)
        for profile, folder in found
        if (profile.world or profile.target) == world
    ]


def serve_one(site: DriverSite, socket: str, tokens: Tokens, pace_by: Clock | None, certificate: Path | None) -> None:
    """Serve the only target of a world."""
    from phyagentos.runtime.targets.receive_log import ReceiveLog
    from phyagentos.runtime.targets.served_target import ServedTarget
    from phyagentos.runtime.targets.server import serve, serve_realtime
    from phyagentos.runtime.targets.stop_listener import StopListener

    target, workspace = site.profile.target, site.workspace
    driver = find_driver(DRIVERS, site.profile, f"{target}/target.yaml").open(site)
    stops = StopListener(workspace.signals.parent, site.clock)
    log, truth = ReceiveLog(workspace.logs / f"receive-{target}.jsonl", site.clock), reads_truth(workspace)
    served = ServedTarget(
        driver, log, is_estopped=stops.is_latched, keep_stop=stops.keep, truth=truth, permits=tokens.permits
    )
    collect_rarely()
    if pace_by is not None:
        serve_realtime(served, open_door(socket, 0.0, certificate), tokens, pace_by)
    else:
        serve(served, open_door(socket, certificate=certificate), tokens)


def serve_shared(sites: list[DriverSite], sockets: Path, tokens: Mapping[str, Tokens], pace_by: Clock | None) -> None:
    """Serve the robots of a world that several targets share."""
    from phyagentos.runtime.drivers.mujoco.shared_target import SharedTarget, serve_together
    from phyagentos.runtime.targets.agreement import AgreementReceiver
    from phyagentos.runtime.targets.receive_log import ReceiveLog
    from phyagentos.runtime.targets.server import serve
    from phyagentos.runtime.targets.stop_listener import StopListener

    workspace, world = sites[0].workspace, sites[0].profile.world
    agreement = AgreementReceiver(sockets / f"{world}.time")
    stops = StopListener(workspace.signals.parent, sites[0].clock)
    robots = open_shared_world(sites, agreement.read if pace_by is None else None)
    members: list[SharedTarget] = []
    for robot in robots:
        log = ReceiveLog(workspace.logs / f"receive-{robot.profile.target}.jsonl", sites[0].clock)
        truth, permits = reads_truth(workspace), tokens[robot.profile.target].permits
        SharedTarget(
            robot, log, members, is_estopped=stops.is_latched, keep_stop=stops.keep, truth=truth, permits=permits
        )
    lock = robots[0].world.simulation.lock
    threading.Thread(target=agreement.wake, args=(lock,), daemon=True, name="hear-what-runs").start()

    def serve_at(target: SharedTarget) -> None:
        name = target.robot.profile.target
        serve(target, open_door(str(sockets / f"{name}.world"), spin_s=0.0), tokens[name])

    collect_rarely()
    serve_together(members, serve_at, pace_by)


def run_worker(root: Path, target: str, socket: str, control: int, *, pictures: bool) -> None:
    """The worker process of one target: serve the watchdog until it is gone."""
    from phyagentos.protocol.settings.runtime_contract import WorldMode
    from phyagentos.runtime.execution.leaf_registry import build_registry
    from phyagentos.runtime.lookahead.gate import LookaheadGate
    from phyagentos.runtime.lookahead.service import RehearsalProcess
    from phyagentos.runtime.motion.process import LocalPlanner, NoModel, Planner, PlannerProcess
    from phyagentos.runtime.motion.tool_bounds import read_tool_bounds
    from phyagentos.runtime.policies.client import ask_policy
    from phyagentos.runtime.policies.policy_runtime import Policies
    from phyagentos.runtime.preflight.compatibility import Preflight
    from phyagentos.runtime.preflight.examination import Examiner
    from phyagentos.runtime.preflight.settings import read_settings
    from phyagentos.runtime.supervision.workers import end_with_parent
    from phyagentos.runtime.targets.receive_log import ReceiveLog
    from phyagentos.runtime.targets.served_target import ServedTarget
    from phyagentos.runtime.targets.server import Loopback
    from phyagentos.runtime.worker.embodiment import Embodiment, SkillLoader
    from phyagentos.runtime.worker.heartbeat import HeartbeatWriter
    from phyagentos.runtime.worker.orders import serve_refusals
    from phyagentos.runtime.worker.recorder import Bundles
    from phyagentos.runtime.worker.runner import SessionRunner
    from phyagentos.runtime.worker.worker import WorkerLoop

    end_with_parent()
    workspace, clock = Workspace.open(root), SystemClock()
    library = workspace.library()
    profile_path = library.get_target(target)
    orders = Link(Connection(control), spin_s=0.0)
    token = orders.recv_bytes()
    try:
        targets = read_target_registry(workspace.target_registry)
        profile, spec = targets[target], choose_driver(targets, target)
        skills = locate_models(read_skill_registry(workspace.skill_registry), library)
        settings = read_settings(workspace, target)
        registry = build_registry(library)
        local = None
        if not spec.own_process:
            site = DriverSite(profile=profile, folder=profile_path.parent, workspace=workspace, clock=clock)
            log = ReceiveLog(workspace.logs / f"receive-{target}.jsonl", clock)
            local = ServedTarget(spec.open(site), log)
    except DefinitionError as error:
        serve_refusals(orders, error.problems)
        return
    bounds = read_tool_bounds(settings.limits)
    shared = {name for name, each in targets.items() if profile.world and each.world == profile.world}
    neighbours = {name: library.get_target(name) for name in sorted(shared - {target})}
    planner: Planner = PlannerProcess(profile_path, bounds, neighbours) if profile.model else LocalPlanner(NoModel())
    connection: Channel = Loopback(local) if local is not None else connect_to_world(socket, token, clock)
    has_truth = not profile.model and profile.kind != "real_robot"
    sees_truth = settings.perception.sensing is Sensing.TRUTH or has_truth
    heartbeat = HeartbeatWriter(workspace.heartbeats, target, clock)
    handle = open_handle(connection, settings.limits, workspace, profile_path, sees_truth=sees_truth)
    world = open_world_model(workspace, target, profile, handle, settings)
    embodiment = Embodiment(handle=handle, world=world, profile=profile, limits=settings.limits)
    policies = Policies(
        skills=skills,
        profile=profile,
        sensors=settings.sensors,
        handle=handle,
        late_max_s=settings.perception.embedded.max_age_s,
        is_realtime=settings.contract.world_mode is WorldMode.REALTIME,
    )
    in_force = (workspace.safety, workspace.sensors, workspace.perception, workspace.runtime_contract)
    runner = SessionRunner(
        target=embodiment,
        skills=SkillLoader(
            planner=planner,
            library=library,
            registry=registry,
            policies=policies,
            skills=skills,
            loops=workspace.loops,
        ),
        bundles=Bundles(workspace.root, settings=in_force, pictures=pictures),
        clock=clock,
        sampling_hz=settings.contract.sampling_hz,
        record=settings.contract.record,
    )
    forecasts = RehearsalProcess([sys.executable, *make_command("rehearsal", workspace.root, target)])
    gate = LookaheadGate(forecasts=forecasts, world=world, evidence=workspace.evidence)
    collect_rarely()
    if settings.contract.world_mode is WorldMode.REALTIME:
        ask_for_precedence()
    WorkerLoop(
        control=orders,
        target=embodiment,
        examiner=Examiner(
            preflight=Preflight(skills=skills, profile=profile, settings=settings, ask_policy=ask_policy),
            handle=handle,
            world=world,
            planner=planner,
            library=library,
            registry=registry,
            clock=clock,
            show_look=runner.bundles.show,
        ),
        runner=runner,
        heartbeat=heartbeat,
        workspace=workspace,
        clock=clock,
        gate=gate,
    ).run()
    gate.close()
    planner.close()


def run_rehearsal(root: Path, target: str, descriptor: int) -> None:
    """Answer the worker until it is gone."""
    from phyagentos.runtime.lookahead.service import open_service, serve
    from phyagentos.runtime.supervision.workers import end_with_parent

    end_with_parent()
    service = open_service(Workspace.open(root), target)
    collect_rarely()
    serve(service, Connection(descriptor))


def open_world_model(
    workspace: Workspace, target: str, profile: TargetProfile, handle: "FrameSource", settings: "Settings"
) -> "WorldModel":
    """What perception.yaml chooses; without a model the robot cannot be masked in pictures.

    A real robot without a camera perceives itself, and nothing else.
    """
    from phyagentos.runtime.perception.world_model import TrueWorld

    if profile.kind == "real_robot" and not settings.sensors.cameras:
        return TrueWorld(target, handle, sensing="perceived", profile=profile)
    if settings.perception.sensing is Sensing.TRUTH or not profile.model:
        return TrueWorld(target, handle, profile=profile)
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


def reads_truth(workspace: Workspace) -> bool:
    """Whether perception.yaml lets sessions read the ground truth; not where it cannot be read."""
    try:
        return read_perception(workspace.perception).sensing is Sensing.TRUTH
    except DefinitionError:
        return False


def open_handle(
    connection: Channel, limits: TargetLimits, workspace: Workspace, description: Path, *, sees_truth: bool = False
) -> "TargetSessionHandle":
    """The worker's access to its target; its guard checks the emergency stop before every command.

    Postures are tested on the robot of its own `description`; preflight compares that with TARGETS.md.
    """
    from phyagentos.runtime.actions.collision import PostureCollision
    from phyagentos.runtime.actions.handle import TargetSessionHandle
    from phyagentos.runtime.models.robot import read_profile

    signals, limit = workspace.signals.parent, limits.collision_depth_max
    collision = None
    if limit is not None:
        collision = PostureCollision(*read_profile(description), min(as_numbers(limit)))
    return TargetSessionHandle(
        connection, limits, is_stopped=lambda: is_latched(signals), collision=collision, sees_truth=sees_truth
    )


def open_door(where: str, spin_s: float = SPIN_S, certificate: Path | None = None) -> "Door":
    """Where commanders come in; a WebSocket's endpoint is printed, since its port may be a free one."""
    from phyagentos.runtime.targets.server import UnixDoor

    if not where.startswith(("ws:", "wss:")):
        return UnixDoor(where, spin_s)
    from phyagentos.runtime.targets.websocket import WebSocketDoor

    parts = urlsplit(where)
    if parts.scheme == "wss" and certificate is None:
        raise DefinitionError.of("NOT_ENCRYPTED", where, "no --certificate", "PEM file of a chain and its private key")
    door = WebSocketDoor(parts.hostname or "127.0.0.1", parts.port or 0, certificate)
    sys.stdout.write(f"{door.endpoint}\n")
    sys.stdout.flush()
    return door


def connect_to_world(socket: str, token: bytes, clock: Clock) -> Link:
    """The connection to a world process that may still be starting, opened with the token of this worker.

    Raises ExecutionError `TARGET_LOST` when it is not served within the start-up time; `BAD_TOKEN`, `VERSION_MISMATCH`.
    """
    deadline_s = clock.now_s() + WORLD_START_S
    while True:
        try:
            link = Link(Client(socket, "AF_UNIX"))
            greet(link, token)
            return link
        except (FileNotFoundError, ConnectionRefusedError) as error:
            if clock.now_s() > deadline_s:
                raise ExecutionError("TARGET_LOST", f"no world listens at {socket}") from error
            clock.sleep(0.02)


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the runtime's own child processes."""
    parser = argparse.ArgumentParser(prog="phyagentos.assembly.processes")
    parser.add_argument("process", choices=("world", "worker", "rehearsal"))
    parser.add_argument("--workspace", type=Path, required=True)
    parser.add_argument("--target", required=True, help="of a worker; for a world its name")
    parser.add_argument("--socket", default="")
    parser.add_argument("--certificate", type=Path, help="PEM file of a chain and its key, to serve at wss://")
    parser.add_argument("--control", type=int, default=-1)
    parser.add_argument("--descriptor", type=int, default=-1)
    parser.add_argument("--no-pictures", action="store_true")
    parser.add_argument("--outlives", action="store_true")
    given = parser.parse_args(argv)
    try:
        if given.process == "world":
            run_world(
                given.workspace, given.target, given.socket, outlives=given.outlives, certificate=given.certificate
            )
        elif given.process == "rehearsal":
            run_rehearsal(given.workspace, given.target, given.descriptor)
        else:
            run_worker(given.workspace, given.target, given.socket, given.control, pictures=not given.no_pictures)
    except (DefinitionError, ExecutionError) as error:
        sys.stderr.write(f"{error}\n")  # now: the frames above hold connections, at whose end the supervisor kills
        sys.exit(1)


if __name__ == "__main__":
    gc.disable()  # until all is loaded: a sixth of a start
    main()
