"""The runtime plane: what `paos watch` starts. Loads neither the agent nor a simulator: bodies are child processes."""

import shutil
import signal
import tempfile
from pathlib import Path
from types import FrameType

from phyagentos.assembly.places import FAULTS, open_project
from phyagentos.clock import SystemClock
from phyagentos.protocol.lifecycle import Side
from phyagentos.protocol.registries import read_target_registry
from phyagentos.protocol.store.journal import Journal
from phyagentos.protocol.views.renderer import Views
from phyagentos.protocol.views.runtime_signal import RuntimeSignal
from phyagentos.protocol.workspace import Workspace
from phyagentos.runtime.watchdog import Watchdog
from phyagentos.runtime.workers import Worker


def run_watch(root: Path, *, faults: Path | None = None, pictures: bool = True, once_idle: bool = False) -> None:
    """The runtime plane: supervise until interrupted.

    Args:
        root: The workspace.
        faults: Fault file for the simulated worlds.
        pictures: Whether evidence has pictures.
        once_idle: End when every goal has its verdict.
    """
    workspace, clock = open_project(root), SystemClock()
    if faults is not None:
        (workspace.root / FAULTS).parent.mkdir(exist_ok=True)
        shutil.copyfile(faults, workspace.root / FAULTS)
    journal = Journal(workspace.root, side=Side.RUNTIME, by="watchdog", clock=clock)
    views = Views(workspace, journal.folder, clock)
    signals = RuntimeSignal(workspace, clock)
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
        watchdog.run()
    views.close()
    journal.close()


def hire_worker(workspace: Workspace, target: str, sockets: Path, *, pictures: bool) -> Worker:
    """Start the world and the worker of one target."""
    place = ["--workspace", str(workspace.root), "--target", target, "--socket", str(sockets / f"{target}.world")]
    return Worker(
        target,
        world=["-m", "phyagentos.assembly.processes", "world", *place],
        worker=["-m", "phyagentos.assembly.processes", "worker", *place, *([] if pictures else ["--no-pictures"])],
        logs=workspace.logs,
    )
