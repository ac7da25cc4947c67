"""RUNTIME_SIGNAL.md and the health in TARGETS.md: liveness, what each worker does, what was requested.

Rendered by the process of the watchdog, at most twice a second, without fsync.
"""

from pathlib import Path
from typing import Protocol

import msgspec

from phyagentos.clock import Clock
from phyagentos.protocol.capabilities.registries import publish_health
from phyagentos.protocol.capabilities.targets import Health, TargetHealth
from phyagentos.protocol.documents.document import Front
from phyagentos.protocol.documents.markdown import format_moment, publish, render_block, render_front, render_table
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.sessions.heartbeats import Heartbeat, is_process_alive, read_heartbeats
from phyagentos.protocol.sessions.runtime_signal import (
    RUNTIME_SIGNAL,
    Request,
    RequestState,
    RuntimeState,
    Signs,
    WorkerSign,
)
from phyagentos.protocol.sessions.stop_signals import list_waiting, read_signal
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.views.sessions import END_MARK

PERIOD_S = 0.5  # between two documents, at least
RENEWAL_S = 10.0  # and at most
SILENCE_S = 2.0  # twenty periods of the writer: the heartbeat of a worker that holds a session does not advance
REQUESTS_SHOWN = 20
_IN_TROUBLE = frozenset({Health.SILENT, Health.LOST})

_FOLDERS = {"done": RequestState.TAKEN, "rejected": RequestState.REJECTED, "new": RequestState.WAITING}
_HEAD = """# Signals of the runtime

Whether a runtime serves this workspace, the latest heartbeat of each target's worker, and the requests to it.

- **Written by** the process of the watchdog, from `heartbeats/` and `signals/`; renewed at least every ten seconds
  while it runs. An older time than that means that it ended without recording its end.
- **To ask for something**, use `paos cancel`, or drop a YAML file into `signals/new/`; any tool can:
  `{kind: cancel, session: "*", by: <who>, reason: <why>}`. Kinds: `cancel`, `pause`, `resume`, `estop`.
- **An edit becomes a request** when it adds a section `## Request` with such a mapping as a YAML block, within a few
  seconds, while a runtime runs. Whatever else is changed is lost with the next rendering.

"""
_NOTHING = "No runtime has been started yet.\n"
_COLUMNS = ("target", "health", "phase", "session", "epoch", "commands", "simulated time", "leaf", "process", "beat")


def render_runtime_signal(signs: Signs | None) -> str:
    """RUNTIME_SIGNAL.md; without an argument as it is before any runtime was started."""
    front = render_front(Front(phy=RUNTIME_SIGNAL.phy))
    if signs is None or signs.runtime is RuntimeState.NOT_STARTED:
        return f"{front}{_HEAD}{_NOTHING}"
    state = (
        f"**The runtime is running**, as of {format_moment(signs.at)}.\n\n"
        if signs.runtime is RuntimeState.RUNNING
        else f"**The runtime ended**, {format_moment(signs.at)}. No worker is alive; the latest heartbeats:\n\n"
    )
    workers = render_table(_COLUMNS, map(_format_worker, signs.workers.values())) + "\n" if signs.workers else ""
    rows = ((each.state.value, each.kind, each.session, each.by, each.reason, each.at) for each in signs.requests)
    table = render_table(("request", "asks for", "session", "by", "why", "at"), rows) + "\n" if signs.requests else ""
    return f"{front}{_HEAD}{state}{workers}{table}## Signs\n\n{render_block(signs)}\n{END_MARK}"


def _format_worker(sign: WorkerSign) -> tuple[str, ...]:
    return (
        sign.target,
        sign.health.value.replace("_", " "),
        sign.phase,
        sign.session or "-",
        str(sign.epoch),
        str(sign.tick),
        f"{sign.sim_time_s:.2f} s",
        sign.leaf or "-",
        str(sign.pid),
        str(sign.sequence),
    )


class SignalEdits(Protocol):
    """Puts RUNTIME_SIGNAL.md where people edit it, and takes out what they ask for; see `edits.signal_intake`."""

    def put(self, text: str) -> bool:
        """Put a rendering there, unless an editor is just replacing it; whether it was done."""

    def is_touched(self) -> bool:
        """Whether the document was changed since it was put there."""

    def take(self, *, at_once: bool = False) -> None:
        """Turn what was asked for into requests."""


class RuntimeSignal:
    """Keeps RUNTIME_SIGNAL.md and the health in TARGETS.md in step with heartbeats and requests.

    Without `edits`, edits of RUNTIME_SIGNAL.md are overwritten.
    """

    def __init__(self, workspace: Workspace, clock: Clock, *, edits: SignalEdits | None = None) -> None:
        self._edits = edits
        self._workspace = workspace
        self._clock = clock
        self._published_at_s = -PERIOD_S
        self._published: Signs | None = None
        self._health: dict[str, Health] = {}
        self._requests: tuple[Request, ...] = ()
        self._requests_changed: tuple[int, ...] = ()
        self._heard: dict[str, tuple[Heartbeat, float]] = {}  # the latest beat and when it was new [s]
        self._earlier = read_heartbeats(workspace.heartbeats)  # left by a runtime before this one

    def refresh(self) -> None:
        """Publish when something changed and it is time."""
        now_s = self._clock.now_s()
        age_s = now_s - self._published_at_s
        if age_s >= PERIOD_S:
            if self._edits is not None:
                self._edits.take()
            signs = self._read(now_s, RuntimeState.RUNNING)
            is_touched = self._edits is not None and self._edits.is_touched()
            is_new = self._published is None or not _is_same(signs, self._published)
            if is_new or is_touched or age_s >= RENEWAL_S:
                self._publish(signs, now_s)

    def close(self) -> None:
        """Publish that the runtime has ended; call it when no worker is left."""
        now_s = self._clock.now_s()
        self._publish(self._read(now_s, RuntimeState.ENDED), now_s)
        if self._edits is not None:
            self._edits.take(at_once=True)

    def _read(self, now_s: float, runtime: RuntimeState) -> Signs:
        workers = {
            target: WorkerSign(**msgspec.structs.asdict(beat), health=self._judge(beat, now_s, runtime))
            for target, beat in read_heartbeats(self._workspace.heartbeats).items()
        }
        folder = self._workspace.signals.parent
        changed = tuple(_read_change(folder / name) for name in _FOLDERS)
        if changed != self._requests_changed:
            self._requests, self._requests_changed = tuple(_list_requests(folder)), changed
        return Signs(runtime=runtime, at=self._clock.wall_iso(), workers=workers, requests=self._requests)

    def _judge(self, beat: Heartbeat, now_s: float, runtime: RuntimeState) -> Health:
        latest = self._heard.get(beat.target)
        if latest is None or latest[0] != beat:
            self._heard[beat.target] = latest = (beat, now_s)
        if runtime is RuntimeState.ENDED or beat == self._earlier.get(beat.target):
            return Health.STOPPED
        if not is_process_alive(beat.pid):
            return Health.LOST
        return Health.SILENT if beat.session and now_s - latest[1] > SILENCE_S else Health.READY

    def _publish(self, signs: Signs, now_s: float) -> None:
        text = render_runtime_signal(signs)
        if self._edits is None:
            publish(self._workspace.runtime_signal, text)
        elif not self._edits.put(text):
            return
        self._published, self._published_at_s = signs, now_s
        health = {name: sign.health for name, sign in signs.workers.items()}
        changed = {
            name: TargetHealth(
                state=state, since=signs.at, session=signs.workers[name].session if state in _IN_TROUBLE else ""
            )
            for name, state in health.items()
            if state is not self._health.get(name)
        }
        if changed:
            publish_health(self._workspace.target_registry, changed)
        self._health = health


def _is_same(a: Signs, b: Signs) -> bool:
    """Whether two are equal but for their time."""
    return (a.runtime, a.workers, a.requests) == (b.runtime, b.workers, b.requests)


def _read_change(folder: Path) -> int:
    """When something last came into a folder or went, by the file system's clock [ns]; -1 without the folder."""
    try:
        return folder.stat().st_mtime_ns
    except FileNotFoundError:
        return -1


def _list_requests(folder: Path) -> list[Request]:
    """The latest requests of `signals/`, oldest first; names begin with their time."""
    found = [
        (path, state)
        for name, state in _FOLDERS.items()
        for path in list_waiting(folder / name)
        if not path.name.endswith(".reason.txt")
    ]
    found.sort(key=lambda each: (each[1] is RequestState.WAITING, each[0].name))
    return [_read_request(path, state) for path, state in found[-REQUESTS_SHOWN:]]


def _read_request(path: Path, state: RequestState) -> Request:
    name = clean(path.name)
    try:
        signal = read_signal(path)
    except (OSError, ValueError):
        return Request(file=name, state=state)
    return Request(file=name, state=state, **msgspec.structs.asdict(signal))
