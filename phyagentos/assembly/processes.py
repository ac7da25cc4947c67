"""The runtime's own child processes, started by the watchdog: a world, a worker and a rehearsal for each target."""

import argparse
import contextlib
import gc
import os
import sys
import threading
import traceback
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn
from urllib.parse import urlsplit

from phyagentos.assembly.drivers import DRIVERS, open_shared_world
from phyagentos.assembly.graphics import choose_graphics
from phyagentos.assembly.paths import open_project
from phyagentos.assembly.process_tuning import ask_for_precedence, collect_rarely
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, find_full_disk
from phyagentos.protocol.settings.perception import Sensing, read_perception
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.channel import SPIN_S
from phyagentos.runtime.targets.driver_registry import DriverSite, find_driver
from phyagentos.runtime.targets.handshake import Tokens

if TYPE_CHECKING:
    from phyagentos.runtime.targets.server import Door


def make_command(process: str, root: Path, target: str, *options: str) -> list[str]:
    """Arguments of the interpreter that start one of these processes."""
    place = ["--workspace", str(root), "--target", target]
    if process == "worker":  # a module of its own: a fork server has loaded the others before it
        return ["-m", "phyagentos.assembly.worker_process", *place, *options]
    return ["-m", "phyagentos.assembly.processes", process, *place, *options]


def run_world(root: Path, world: str, socket: str, *, outlives: bool, certificate: Path | None = None) -> None:
    """The process of one world, and of every target in it, until its supervisor ends.

    A world that is not shared has the name of its only target, which listens at `socket`: the path of a UNIX socket, or
    `ws://host:port`, with a `certificate` `wss://host:port`, for commanders of other workspaces. Targets that share a
    world listen beside that path, each at `<target>.world`, or at that port and those behind it, in the order of their
    names. With `outlives`, it waits for another watchdog when the process that started it dies.

    Raises:
        ExecutionError: `BUSY` when another one lives.
        DefinitionError: `NO_DRIVER`, `WORLD_CONFLICT`, `NOT_SECURED`, or problems of the targets' profiles.
    """
    from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, become_sole, is_held_by
    from phyagentos.runtime.supervision.workers import end_with_parent
    from phyagentos.runtime.supervision.world_process import end_when_unwatched, get_lock

    workspace, clock = open_project(root) if is_port(socket) else Workspace.open(root), SystemClock()
    become_sole(get_lock(workspace.root, world), clock, "BUSY", f"another world process has {world}")
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
        serve_shared(sites, socket, tokens, pace_by, certificate)


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


def serve_shared(
    sites: list[DriverSite], socket: str, tokens: Mapping[str, Tokens], pace_by: Clock | None, certificate: Path | None
) -> None:
    """Serve the robots of a world that several targets share.

    For commanders of other workspaces no runtime plane says which sessions run: in lockstep, those that have begun do.
    """
    from phyagentos.runtime.drivers.mujoco.shared_target import SharedTarget, serve_together
    from phyagentos.runtime.targets.agreement import AgreementReceiver
    from phyagentos.runtime.targets.receive_log import ReceiveLog
    from phyagentos.runtime.targets.server import serve
    from phyagentos.runtime.targets.stop_listener import StopListener

    workspace, world = sites[0].workspace, sites[0].profile.world
    agreement = None if is_port(socket) else AgreementReceiver(Path(socket).parent / f"{world}.time")
    stops = StopListener(workspace.signals.parent, sites[0].clock)
    robots = open_shared_world(sites, agreement.read if agreement is not None and pace_by is None else None)
    members: list[SharedTarget] = []
    for robot in robots:
        log = ReceiveLog(workspace.logs / f"receive-{robot.profile.target}.jsonl", sites[0].clock)
        truth, permits = reads_truth(workspace), tokens[robot.profile.target].permits
        SharedTarget(
            robot, log, members, is_estopped=stops.is_latched, keep_stop=stops.keep, truth=truth, permits=permits
        )
    lock = robots[0].world.simulation.lock
    if agreement is not None:
        threading.Thread(target=agreement.wake, args=(lock,), daemon=True, name="hear-what-runs").start()
    doors = {name: open_door(place, 0.0, certificate) for name, place in locate_doors(socket, list(tokens)).items()}

    def serve_at(target: SharedTarget) -> None:
        name = target.robot.profile.target
        serve(target, doors[name], tokens[name])

    collect_rarely()
    serve_together(members, serve_at, pace_by)


def run_rehearsal(root: Path, target: str, descriptor: int) -> None:
    """Answer the worker until it is gone."""
    from phyagentos.runtime.lookahead.service import open_service, serve
    from phyagentos.runtime.supervision.workers import end_with_parent

    end_with_parent()
    service = open_service(Workspace.open(root), target)
    collect_rarely()
    serve(service, Connection(descriptor))


def reads_truth(workspace: Workspace) -> bool:
    """Whether perception.yaml lets sessions read the ground truth; not where it cannot be read."""
    try:
        return read_perception(workspace.perception).sensing is Sensing.TRUTH
    except DefinitionError:
        return False


def is_port(where: str) -> bool:
    """Whether commanders come over the network."""
    return where.startswith(("ws:", "wss:"))


def locate_doors(socket: str, targets: Sequence[str]) -> dict[str, str]:
    """Where each target of a shared world listens."""
    if not is_port(socket):
        return {name: str(Path(socket).parent / f"{name}.world") for name in targets}
    parts = urlsplit(socket)
    where = socket if parts.port is None else socket.rpartition(":")[0]
    return {name: f"{where}:{parts.port + number if parts.port else 0}" for number, name in enumerate(targets)}


def open_door(where: str, spin_s: float = SPIN_S, certificate: Path | None = None) -> "Door":
    """Where commanders come in; a WebSocket's endpoint is printed, since its port may be a free one."""
    from phyagentos.runtime.targets.server import UnixDoor

    if not is_port(where):
        return UnixDoor(where, spin_s)
    from phyagentos.runtime.targets.websocket import WebSocketDoor

    parts = urlsplit(where)
    if parts.scheme == "wss" and certificate is None:
        raise DefinitionError.of("NOT_SECURED", where, "no --certificate", "PEM file of a chain and its private key")
    door = WebSocketDoor(parts.hostname or "127.0.0.1", parts.port or 0, certificate)
    sys.stdout.write(f"{door.endpoint}\n")
    sys.stdout.flush()
    return door


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of worlds and rehearsals."""
    parser = argparse.ArgumentParser(prog="phyagentos.assembly.processes")
    parser.add_argument("process", choices=("world", "rehearsal"))
    parser.add_argument("--workspace", type=Path, required=True)
    parser.add_argument("--target", required=True, help="of a rehearsal; for a world its name")
    parser.add_argument("--socket", default="")
    parser.add_argument("--certificate", type=Path, help="PEM file of a chain and its key, to serve at wss://")
    parser.add_argument("--descriptor", type=int, default=-1)
    parser.add_argument("--outlives", action="store_true")
    given = parser.parse_args(argv)
    with ending_by_errors():
        if given.process == "world":
            run_world(
                given.workspace, given.target, given.socket, outlives=given.outlives, certificate=given.certificate
            )
        else:
            run_rehearsal(given.workspace, given.target, given.descriptor)


@contextlib.contextmanager
def ending_by_errors() -> Iterator[None]:
    """A block whose errors end this process, with a line for its log; of a defect the whole traceback."""
    try:
        yield
    except (DefinitionError, ExecutionError) as error:
        _end(f"{error}\n")  # now: the frames above hold connections, at whose end the supervisor kills
    except Exception as error:
        place = find_full_disk(error)
        _end(f"{place}: no room is left on its disk\n" if place else traceback.format_exc())


def _end(text: str) -> NoReturn:
    """End with the code of an own error, also where a full disk takes no word of it."""
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except OSError:
        sys.stderr = None  # else the interpreter flushes it again, and ends with another code
    sys.exit(os.EX_SOFTWARE)


if __name__ == "__main__":
    gc.disable()  # until all is loaded: a sixth of a start
    main()
