"""The runtime plane: what `paos watch` starts. Loads neither the agent nor a simulator: bodies are child processes."""

import shutil
import signal
import tempfile
from pathlib import Path
from types import FrameType

from phyagentos.assembly.garbage import collect_rarely
from phyagentos.assembly.places import FAULTS, open_project
from phyagentos.clock import SystemClock
from phyagentos.protocol.edits.desk import Desk
from phyagentos.protocol.edits.signal_desk import SignalDesk
from phyagentos.protocol.lifecycle import Side
from phyagentos.protocol.registries import read_target_registry
from phyagentos.protocol.runtime_contract import WorldMode, declare_world_mode
from phyagentos.protocol.store.journal import Journal
from phyagentos.protocol.views.renderer import Views
from phyagentos.protocol.views.runtime_signal import RuntimeSignal
from phyagentos.protocol.workspace import Workspace
from phyagentos.runtime.watchdog import Watchdog
from phyagentos.runtime.workers import Worker


def run_watch(
    root: Path,
    *,
    faults: Path | None = None,
    pictures: bool = True,
    once_idle: bool = False,
    world_mode: WorldMode | None = None,
) -> None:
    """The runtime plane: supervise until interrupted.

    Args:
        root: The workspace.
        faults: Fault file for the simulated worlds.
        pictures: Whether evidence has pictures.
        world_mode: Declared in the workspace's runtime_contract.yaml; None leaves what stands there.
        once_idle: End when every goal has its verdict.
    """
    workspace, clock = open_project(root), SystemClock()
    if world_mode is not None:
        declare_world_mode(workspace.runtime_contract, world_mode)
    if faults is not None:
        (workspace.root / FAULTS).parent.mkdir(exist_ok=True)
        shutil.copyfile(faults, workspace.root / FAULTS)
    journal = Journal(workspace.root, side=Side.RUNTIME, by="watchdog", clock=clock)
    desk = Desk(workspace, clock)
    views = Views(workspace, journal.folder, clock, desk=desk)
    signal_desk = SignalDesk(workspace, clock)
    signals = RuntimeSignal(workspace, clock, desk=signal_desk)
    known = read_target_registry(workspace.target_registry)

    with tempfile.TemporaryDirectory(prefix="paos-") as sockets:

        def hire(target: str) -> Worker | None:
            return hire_worker(workspace, target, Path(sockets), pictures=pictures) if target in known else None

        def publish() -> None:
            views.refresh()
            signals.refresh()
            goals = views.ledger.goals.values()
            if once_idle and goals and all(goal.verdict or goal.is_cancelled for goal in goals):
                watchdog.stop()

        watchdog = Watchdog(workspace=workspace, journal=journal, hire=hire, clock=clock, publish=publish)

        def on_signal(_number: int, _frame: FrameType | None) -> None:
            watchdog.stop()

        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, on_signal)
        collect_rarely()
        watchdog.run()
    views.close()
    desk.close()
    signals.close()
    signal_desk.close()
    journal.close()


def hire_worker(workspace: Workspace, target: str, sockets: Path, *, pictures: bool) -> Worker:
    """Start the world and the worker of one target; a debug target lives in its worker and begins anew with it."""
    is_debug = read_target_registry(workspace.target_registry)[target].kind == "debug"
    place = ["--workspace", str(workspace.root), "--target", target, "--socket", str(sockets / f"{target}.world")]
    return Worker(
        target,
        world=[] if is_debug else ["-m", "phyagentos.assembly.processes", "world", *place],
        worker=["-m", "phyagentos.assembly.processes", "worker", *place, *([] if pictures else ["--no-pictures"])],
        logs=workspace.logs,
    )
