"""The runtime plane: what `paos watch` starts. Loads neither the agent nor a simulator: bodies are child processes."""

import contextlib
import shutil
import signal
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path

import msgspec

from phyagentos.assembly.drivers import choose_driver
from phyagentos.assembly.graphics import require_graphics
from phyagentos.assembly.paths import FAULTS, make_socket_folder, open_project, remove_socket_folders, serve_alone
from phyagentos.assembly.planes import STOP_S
from phyagentos.assembly.process_tuning import ask_for_prompt_wakeups, collect_rarely
from phyagentos.assembly.processes import make_command, reads_truth
from phyagentos.clock import Clock, SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, PhyAgentOSError
from phyagentos.protocol.capabilities.registries import read_target_registry
from phyagentos.protocol.capabilities.targets import TargetProfile, find_own_world
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.sessions.evidence_manifest import Sealer, list_unsealed
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, Side
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.settings.runtime_contract import (
    RuntimeContract,
    WorldMode,
    read_runtime_contract,
)
from phyagentos.protocol.settings.settings_files import declare
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, become_sole
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.supervision.shared_time import SharedTime
from phyagentos.runtime.supervision.watchdog import Watchdog
from phyagentos.runtime.supervision.workers import Worker
from phyagentos.runtime.supervision.world_process import WorldProcess, end_worlds, get_lock
from phyagentos.scratch import open_scratch
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.journal import Journal, Record
from phyagentos.store.ledger import Ledger
from phyagentos.store.renderer import Views
from phyagentos.store.retention import apply_retention, read_retention
from phyagentos.store.runtime_signal import RuntimeSignal
from phyagentos.store.turn_marks import TurnMarks

EVERY = 1000  # sessions that ended between two clean-ups
PAUSE_S = 0.002  # before each bundle: the plane goes first


class EvidenceKeeper:
    """Thins old evidence after so many sessions, as `paos evidence prune` does, in a thread that pauses often."""

    def __init__(self, workspace: Workspace, clock: Clock, every: int = EVERY) -> None:
        self._workspace, self._clock, self._every = workspace, clock, every
        self._ended = 0
        self._is_over = threading.Event()
        self._thread: threading.Thread | None = None

    def take_in(self, record: Record) -> None:
        """Count sessions that end."""
        self._ended += record.to in FINAL_STATES

    def refresh(self) -> None:
        """Begin a clean-up when one is due and none runs; its report is `logs/prune.log`."""
        if self._ended >= self._every and (self._thread is None or not self._thread.is_alive()):
            self._ended = 0
            self._thread = threading.Thread(target=self._clean_up, name="evidence", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """End a clean-up after its present bundle; the next one goes on from there."""
        self._is_over.set()
        if self._thread is not None:
            self._thread.join()

    def _clean_up(self) -> None:
        try:
            policy = read_retention(self._workspace)
            done = apply_retention(self._workspace, policy, self._clock, goes_on=self._pause)
            report = msgspec.json.encode(done)
        except (PhyAgentOSError, OSError) as error:  # then the next
            report = str(error).encode()
        with contextlib.suppress(OSError):
            (self._workspace.logs / "prune.log").write_bytes(report + b"\n")

    def _pause(self) -> bool:
        return not self._is_over.wait(PAUSE_S)


def run_watch(
    root: Path,
    *,
    faults: Path | None = None,
    pictures: bool = True,
    once_idle: bool = False,
    world_mode: WorldMode | None = None,
    sense: Sensing | None = None,
    outlived: bool = True,
    expected: Collection[str] = (),
) -> None:
    """The runtime plane: supervise until interrupted; raises `BUSY`, and as `require_graphics`.

    `faults`, `world_mode` and `sense` are written into the workspace; None leaves what is declared there. With
    `once_idle` it ends when every goal has its verdict. With `outlived`, worlds wait for another watchdog when this one
    dies. Targets that are `expected` to be used are started at once.
    """
    require_graphics()
    workspace, clock = open_project(root), SystemClock()
    with serve_alone(workspace, clock) if outlived else contextlib.nullcontext():  # else the parent does
        lock, busy = workspace.root / WATCHDOG_LOCK, "another watchdog supervises this workspace"
        become_sole(lock, clock, "BUSY", busy, patience_s=STOP_S)  # that of a command that died is ending
        declare_world(workspace, faults, world_mode, sense)
        try:
            _supervise(workspace, clock, expected, pictures=pictures, once_idle=once_idle, outlived=outlived)
        finally:
            end_worlds(workspace.root)
            remove_socket_folders(workspace.root)


def declare_world(
    workspace: Workspace, faults: Path | None, mode: WorldMode | None, sense: Sensing | None = None
) -> None:
    """Write down how worlds are started from now on, and end those that an earlier watchdog started otherwise.

    None for `faults`, `mode` or `sense` (perception.yaml) leaves what is declared.
    """
    before = _read_terms(workspace)
    declare(workspace.perception, sensing=sense)
    declare(workspace.runtime_contract, world_mode=mode)
    if faults is not None:
        (workspace.root / FAULTS).parent.mkdir(exist_ok=True)
        shutil.copyfile(faults, workspace.root / FAULTS)
    if _read_terms(workspace) != before:
        end_worlds(workspace.root)


def _read_terms(workspace: Workspace) -> tuple[WorldMode, bool, bytes]:
    """What a world is started with, and keeps."""
    path = workspace.root / FAULTS
    return _read_rules(workspace).world_mode, reads_truth(workspace), read_regular(path) if path.exists() else b""


def _supervise(
    workspace: Workspace, clock: Clock, expected: Collection[str], *, pictures: bool, once_idle: bool, outlived: bool
) -> None:
    sockets = make_socket_folder(workspace.root)
    journal = Journal(workspace.root, side=Side.RUNTIME, by="watchdog", clock=clock)
    views = Views(workspace, journal.folder, clock, edits := EditIntake(workspace, clock))
    signals = RuntimeSignal(workspace, clock)
    shared = open_shared_time(known := read_target_registry(workspace.target_registry), workspace, sockets, clock)
    keeper = EvidenceKeeper(workspace, clock)

    def on_record(record: Record) -> None:
        keeper.take_in(record)
        if shared is not None:
            shared.take_in(record)

    def publish() -> None:
        views.refresh()
        signals.refresh()
        keeper.refresh()
        if once_idle and _is_done(watchdog.ledger):
            watchdog.stop()

    rules = _read_rules(workspace)
    watchdog = Watchdog(
        workspace=workspace,
        journal=journal,
        hire=make_hire(workspace, known, sockets, pictures=pictures, outlived=outlived),
        clock=clock,
        publish=publish,
        on_record=on_record,
        shared_time=shared,
        expected=expected,
        ageing_per_s=rules.ageing_per_min / 60.0,
        lease_s=rules.lease_s,
    )
    seal_rest(workspace, watchdog.ledger)  # of a runtime that was killed
    signal.signal(signal.SIGTERM, lambda *_: watchdog.stop())
    signal.signal(signal.SIGINT, lambda *_: watchdog.stop())
    collect_rarely()
    if rules.world_mode is WorldMode.LOCKSTEP:
        ask_for_prompt_wakeups()
    watchdog.run()
    if shared is not None:
        shared.close()
    views.close()
    keeper.close()
    seal_rest(workspace, watchdog.ledger)
    edits.close()
    signals.close()
    journal.close()


def _is_done(ledger: Ledger) -> bool:
    """Whether there are goals, and each has its verdict."""
    return bool(ledger.goals) and all(goal.verdict or goal.is_cancelled for goal in ledger.goals.values())


def make_hire(
    workspace: Workspace, known: Mapping[str, TargetProfile], sockets: Path, *, pictures: bool, outlived: bool
) -> Callable[[str], Worker | None]:
    """What starts the worker of a target, with its world where that does not run yet; None for an unknown target."""
    worlds: dict[str, WorldProcess | None] = {}

    def hire(target: str) -> Worker | None:
        if target not in known:
            return None
        world = known[target].world or target
        if world not in worlds:
            worlds[world] = start_world(workspace, target, sockets, outlives=outlived)
        return hire_worker(workspace, target, sockets, pictures=pictures, world=worlds[world])

    return hire


def open_shared_time(
    targets: Mapping[str, TargetProfile], workspace: Workspace, sockets: Path, clock: Clock
) -> SharedTime | None:
    """What holds the time of shared worlds, and repeatable targets in turn; None without any, and in real time."""
    worlds = {name: world for name, profile in targets.items() if (world := find_own_world(profile))}
    shared = {
        world: ([name for name, each in worlds.items() if each == world], sockets / f"{world}.time")
        for world, count in Counter(worlds.values()).items()
        if count > 1
    }
    is_lockstep = _read_rules(workspace).world_mode is WorldMode.LOCKSTEP
    in_turn = [name for name, profile in targets.items() if profile.deterministic]
    if not (is_lockstep and (shared or in_turn)):
        return None
    return SharedTime(shared, TurnMarks(workspace.cache), clock, in_turn)


def seal_rest(workspace: Workspace, ledger: Ledger) -> None:
    """Record the hashes of bundles that no worker will: it was lost, stopped or busy, or its disk was full."""
    sealer = Sealer(workspace.evidence)
    for folder in list_unsealed(workspace.evidence):
        status = ledger.sessions.get(SessionId(folder.name))  # None: it was over long ago
        is_live = status is not None and status.execution is None and status.state not in FINAL_STATES
        if not is_live:  # one that was refused has its look-ahead
            with contextlib.suppress(OSError, ExecutionError):  # then the next start does
                sealer.seal(folder, late=True)


def _read_rules(workspace: Workspace) -> RuntimeContract:
    """Settings of runtime_contract.yaml; defaults where it cannot be read, which preflight reports."""
    try:
        return read_runtime_contract(workspace.runtime_contract)
    except DefinitionError:
        return RuntimeContract(
            world_mode=WorldMode.REALTIME,
            control_period_s=0.02,
            physics_step_s=0.002,
            command_representation="joint_position_velocity",
            sampling_hz=10.0,
        )


def start_world(workspace: Workspace, target: str, sockets: Path, *, outlives: bool = False) -> WorldProcess | None:
    """Start the process of a target's world, or adopt the one that lives; None where the driver needs none.

    With `outlives`, the world waits for another watchdog when this process dies.
    """
    known = read_target_registry(workspace.target_registry)
    try:
        if not choose_driver(known, target).own_process:
            return None
    except DefinitionError:  # the worker refuses
        return None
    world = known[target].world or target
    options = ["--socket", str(sockets / f"{world}.world"), *(["--outlives"] if outlives else [])]
    command = make_command("world", workspace.root, world, *options)
    return WorldProcess(command, get_lock(workspace.root, world), workspace.logs / f"world-{world}.log")


@contextlib.contextmanager
def open_worker(workspace: Workspace, target: str) -> Iterator[Worker]:
    """The worker of one target that is ready for orders, with a world and sockets of its own, while the block runs."""
    require_graphics()
    with open_scratch() as sockets:
        world = start_world(workspace, target, sockets)
        worker = hire_worker(workspace, target, sockets, pictures=False, world=world)
        try:
            worker.receive()  # ready
            yield worker
        finally:
            worker.stop()


def hire_worker(
    workspace: Workspace, target: str, sockets: Path, *, pictures: bool, world: WorldProcess | None
) -> Worker:
    """Start the worker of one target; without a driver it refuses every session."""
    socket = sockets / f"{target}.world"
    options = ["--socket", str(socket), *([] if pictures else ["--no-pictures"])]
    command = make_command("worker", workspace.root, target, *options)
    return Worker(target, world=world, worker=command, logs=workspace.logs, socket=socket)
