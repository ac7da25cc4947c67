"""RUNTIME_SIGNAL.md and the health in TARGETS.md: liveness, what each worker does, what was requested.

Rendered by the process of the watchdog, at most twice a second, without fsync. Of edits an added section `## Request`
becomes a file of `signals/`; other changes are lost.
"""

import re
from pathlib import Path

import msgspec

from phyagentos.clock import Clock
from phyagentos.protocol.capabilities.registries import publish_health
from phyagentos.protocol.capabilities.targets import Health, TargetHealth
from phyagentos.protocol.documents.document import Front, iter_blocks
from phyagentos.protocol.documents.markdown import format_moment, render_block, render_front, render_table
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
from phyagentos.protocol.sessions.stop_signals import drop_request, list_waiting, read_signal
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.shared_file import SharedFile, decode
from phyagentos.store.views.sessions import END_MARK

PERIOD_S = 0.5  # between two documents, at least
RENEWAL_S = 10.0  # and at most
SILENCE_S = 2.0  # twenty periods of the writer: the heartbeat of a worker that holds a session does not advance
REQUESTS_SHOWN = 20
REQUEST = "Request"  # heading of a request
_REQUEST = re.compile(rf"^## {REQUEST}[ \t]*$", re.MULTILINE)
_NEXT = re.compile(r"^## ", re.MULTILINE)
_AT = re.compile(r"^at: \S.*$", re.MULTILINE)
_IN_TROUBLE = frozenset({Health.SILENT, Health.LOST})

_FOLDERS = {"done": RequestState.TAKEN, "rejected": RequestState.REJECTED, "new": RequestState.WAITING}
_HEAD = """# Signals of the runtime

Whether a runtime serves this workspace, the latest heartbeat of each target's worker, and the requests to it.

- **Written by** the process of the watchdog, from `heartbeats/` and `signals/`; renewed at least every ten seconds
  while it runs. An older time than that means that it ended without recording its end.
- **To ask for something**, use `paos cancel`, or drop a YAML file into `signals/new/`; any tool can:
  `{kind: cancel, session: "*", by: <who>, reason: <why>}`. Kinds: `cancel`, `pause`, `resume`, `estop`, and
  `take_over` with the `leader` whose commands move the arm.
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


class RuntimeSignal:
    """Keeps RUNTIME_SIGNAL.md and the health in TARGETS.md in step with heartbeats and requests."""

    def __init__(self, workspace: Workspace, clock: Clock) -> None:
        self._workspace, self._clock = workspace, clock
        self._file = SharedFile(workspace.runtime_signal, workspace.edits / "signals", clock)
        self._file.adopt()
        self._known: set[tuple[str, str]] = set()
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
            self._file.take(self._take_requests)
            signs = self._read(now_s, RuntimeState.RUNNING)
            is_new = self._published is None or msgspec.structs.replace(self._published, at=signs.at) != signs
            if is_new or age_s >= RENEWAL_S or self._file.is_touched():
                self._publish(signs, now_s)

    def close(self) -> None:
        """Publish that the runtime has ended; call it when no worker is left."""
        now_s = self._clock.now_s()
        self._publish(self._read(now_s, RuntimeState.ENDED), now_s)
        self._file.take(self._take_requests, at_once=True)
        self._file.close()

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
        if not self._file.put(render_runtime_signal(signs)):
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

    def _take_requests(self, data: bytes, _is_whole: bool) -> None:
        text = decode(data)
        shown = _AT.search(text)
        for request in find_requests(text):
            edit = (shown[0] if shown else "", request)  # a second save of the same text asks for nothing new
            if edit not in self._known:
                self._known.add(edit)
                data = request.encode(errors="backslashreplace")
                drop_request(self._workspace.signals, data, self._clock, "-edit.yaml")


def find_requests(text: str) -> list[str]:
    """The YAML of each `## Request` section; all of its text where it holds no complete block."""
    requests = []
    for match in _REQUEST.finditer(text):
        following = _NEXT.search(text, match.end())
        section = text[match.end() : following.start() if following else len(text)].replace(END_MARK, "")
        block = next(iter_blocks(f"## {REQUEST}\n{section}"), None)
        requests.append(block.yaml if block is not None else f"{section.strip()}\n")
    return requests


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
