"""Looking at runs from outside: `status`, `runs`, `logs`."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from phyagentos.cli.arguments import AsJson, find_running, find_workspaces
from phyagentos.cli.explaining import Space
from phyagentos.cli.history import read_ledger
from phyagentos.cli.outcome import print_found, print_result
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.sessions.estop import Latch, read_latch
from phyagentos.protocol.sessions.heartbeats import Heartbeat, read_heartbeats
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.watch import POLL_S, Watch


class Standing(msgspec.Struct, frozen=True, kw_only=True):
    """How a workspace stands: its verdict by goal, its number of sessions by state, what its live workers do."""

    workspace: str
    is_running: bool
    latch: Latch | None
    goals: dict[str, str]
    sessions: dict[str, int]
    workers: tuple[Heartbeat, ...]

    @classmethod
    def read(cls, root: Path) -> "Standing":
        """From outside; changes nothing."""
        place, ledger = Workspace.open(root), read_ledger(root)
        is_running, goals = is_held(place.root / WATCHDOG_LOCK), ledger.goals.values()
        return cls(
            workspace=str(root),
            is_running=is_running,
            latch=read_latch(place.signals.parent),
            goals={goal.id: goal.verdict or ("cancelled" if goal.is_cancelled else "open") for goal in goals},
            sessions=dict(Counter(str(each.state) for each in ledger.sessions.values())),
            workers=tuple(read_heartbeats(place.heartbeats).values()) if is_running else (),
        )

    def __str__(self) -> str:
        runs = ["running" if self.is_running else "not running", *(["emergency stop"] if self.latch else [])]
        goals = [f"{goal} {verdict}" for goal, verdict in self.goals.items()] or ["no goal"]
        return f"{self.workspace}: {', '.join([*runs, *goals, *(f'{n} {each}' for each, n in self.sessions.items())])}"


def status(workspace: Space, as_json: AsJson = False) -> None:
    """Show how a workspace stands: its runtime, emergency stop, goals, sessions, and what each worker does."""
    found = Standing.read(workspace)
    lines = [str(found)]
    if found.latch is not None:
        lines.append(f"  emergency stop by {found.latch.by or '?'}: {found.latch.reason or 'no reason given'}")
    for beat in found.workers:
        doing = f"{beat.session} {beat.leaf}, {beat.sim_time_s:.1f} s simulated" if beat.session else ""
        lines.append(f"  {beat.target}: {beat.phase} {doing}".rstrip())
    print_found(found, "\n".join(lines), as_json=as_json)


def runs(as_json: AsJson = False) -> None:
    """List the workspaces here, the newest first, and those that run elsewhere."""
    here = find_workspaces()
    away = [root for root in find_running() if root not in {path.resolve() for path in here}]
    found = [Standing.read(root) for root in (*here, *away)]
    none = "no workspace in workspaces/; `paos run GRAPH` makes one"
    print_found(found, "\n".join(map(str, found)) or none, as_json=as_json)


def logs(
    workspace: Space,
    name: Annotated[str, typer.Argument(help="One log: agent, watch, worker-TARGET, world-TARGET; all without.")] = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on with what is written, until Ctrl-C.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
) -> None:
    """Print what the processes of a run have printed."""
    folder = Workspace.open(workspace).logs
    known = sorted(path.stem for path in folder.glob("*.log"))
    if name and name not in known:
        raise DefinitionError.unknown("UNKNOWN_FILE", str(folder), name, known)
    read: dict[Path, int] = {}
    with Watch([folder]) as watch:
        while True:
            for log, line in _read_lines(folder, name or "*", read):
                plain = line if name else f"{log}: {line}"
                print_result(msgspec.json.encode({"log": log, "line": line}).decode() if as_json else plain)
            if not follow:
                return
            watch.wait(POLL_S)


def _read_lines(folder: Path, name: str, read: dict[Path, int]) -> Iterator[tuple[str, str]]:
    """Lines that were not `read` yet, in bytes by file, each with its log; clean for a terminal."""
    for path in sorted(folder.glob(f"{name}.log")):
        with path.open("rb") as file:
            file.seek(read.get(path, 0))
            whole, newline, _ = file.read().rpartition(b"\n")
        read[path] = read.get(path, 0) + len(whole + newline)
        for line in whole.decode(errors="replace").splitlines():
            yield path.stem, clean(line)
