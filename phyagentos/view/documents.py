"""What a page reads of a workspace: the journal as it grows, heartbeats, bundles; nothing is asked of any process."""

import os
import threading
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import msgspec

from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.sessions.evidence import TRACE, Bundle, read_bundle
from phyagentos.protocol.sessions.heartbeats import Heartbeat, is_process_alive, read_heartbeats
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, REVIEW, SessionState, Side
from phyagentos.protocol.sessions.session import Ended, Execution, GoalId, SessionId, SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment, read_environment
from phyagentos.store.follower import Follower
from phyagentos.store.journal import choose_partition
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record

BUNDLES_KEPT = 64
_MISSED = ((SessionState.FAILED, SessionState.REJECTED), (SessionState.REPLANNED,))  # what is worth a look first
_WATCHED = (
    "signals",
    "signals/new",
    "proposals/new",
    "proposals/decisions",
    "logs",
    "ENVIRONMENT.md",
    "LESSONS.md",
    "KNOWLEDGE.md",
)


@dataclass(frozen=True, slots=True)
class Version:
    """When something that a page shows has changed.

    Attributes:
        journal: Its last record.
        beats: Latest write of a heartbeat [ns].
        traces: Latest write of the trace of a session that runs [ns].
        files: Latest change of the other documents [ns].
        stage: How far a run has begun: see `Documents.list_stages`.
    """

    journal: int = 0
    beats: int = 0
    traces: int = 0
    files: int = 0
    stage: int = 0


@dataclass(frozen=True, slots=True)
class Passage:
    """A state that a session has entered, at a wall time (UTC)."""

    state: str
    at: str


class Documents:
    """The documents of one workspace, `given` as who opened it named it; may be used by several threads."""

    def __init__(self, root: Path) -> None:
        self.workspace, self.given = Workspace.open(root), root
        self.ledger = Ledger(forgets=False)
        self.passages: dict[SessionId, list[Passage]] = defaultdict(list)
        self.requests: list[Record] = []  # of operators
        self.version = Version()
        self._is_served = False  # as of the last refresh
        self._bundles: dict[tuple[str, str, int], Bundle] = {}
        self._follower: Follower | None = None
        self._lock = threading.Lock()

    def refresh(self) -> Version:
        """Read what is new; raises ExecutionError `JOURNAL_DAMAGED`."""
        with self._lock:
            folder = self.workspace.sessions / choose_partition(self.workspace.sessions)
            if self._follower is None and folder.is_dir():
                self._follower = Follower(folder)
            for record in self._follower.read_new() if self._follower is not None else ():
                self.ledger.apply(record)
                if record.to is not None and record.ev != REVIEW:  # which leaves a session as it is
                    self.passages[SessionId(record.id)].append(Passage(str(record.to), record.at))
                if record.side == Side.OPERATOR:
                    self.requests.append(record)
            beats = find_latest([*self.workspace.heartbeats.glob("*.json")])
            traces = find_latest([self.workspace.evidence_of(id) / TRACE for id in self.list_running()])
            files = [self.workspace.root / name for name in _WATCHED]
            files += map(self.workspace.answers_of, self.ledger.goals)
            newest = find_latest([*files, *self.workspace.logs.glob("*.log")])
            stages = self.list_stages()
            self._is_served = stages["runtime"]
            self.version = Version(self.ledger.seq, beats, traces, newest, sum(stages.values()))
            return self.version

    def is_running(self) -> bool:
        """Whether a runtime serves the workspace."""
        return self._is_held(WATCHDOG_LOCK)

    def list_stages(self) -> dict[str, bool]:
        """What has to be there before a robot moves, in this order; whether it is."""
        sessions = list(self.ledger.live_sessions())
        states = {each.state for each in sessions}
        is_up, goal = self.is_running(), self.find_goal()
        is_open = goal is not None and not goal.verdict and not goal.is_cancelled
        begun = states - {SessionState.PENDING, SessionState.CLAIMED}
        return {
            "command": is_up or self._is_held(RUNTIME_LOCK),
            "runtime": is_up,
            "goal": is_open,
            "plan": is_open and bool(sessions),
            "worker": is_up and any(is_process_alive(beat.pid) for beat in self.read_beats().values()),
            "world": bool(begun),
            "motion": bool(begun - {SessionState.PREFLIGHT}),
        }

    def _is_held(self, lock: Path) -> bool:
        try:
            return is_held(self.workspace.root / lock)
        except OSError:  # a copy that may only be read
            return False

    def list_running(self) -> list[SessionId]:
        """Sessions that a worker holds."""
        return [status.contract.id for status in self.ledger.live_sessions() if status.claimed_by]

    def find_goal(self, id: str = "") -> GoalStatus | None:
        """A goal by its id, the latest one without."""
        latest = next(reversed(self.ledger.goals), GoalId(""))
        return self.ledger.goals.get(GoalId(id or latest))

    def find_session(self, id: str = "", goal: str = "") -> SessionStatus | None:
        """A session by its id; without one that which runs or waits, else one that failed last, or was replanned last.

        Without such a one it is the latest. Without a name the goal is that of the latest session.
        """
        if id:
            return self.ledger.sessions.get(SessionId(id))
        of_goal = [each for each in self.ledger.sessions.values() if not goal or each.contract.goal == goal]
        live = [each for each in of_goal if each.state not in FINAL_STATES]
        last = [each for each in reversed(of_goal) if each.contract.goal == of_goal[-1].contract.goal]
        missed = [each for state in _MISSED for each in last if each.state in state]
        return next(iter([*(each for each in live if each.claimed_by), *live, *missed, *last]), None)

    def read_beats(self) -> dict[str, Heartbeat]:
        """The latest heartbeat of each target."""
        return read_heartbeats(self.workspace.heartbeats)

    def read_pulse(self) -> str:
        """What moves, as JSON: of each target its name, session, phase, active leaf and simulated time [s].

        Nothing moves in a workspace that no runtime serves.
        """
        beats = self.read_beats().values() if self._is_served else ()
        return msgspec.json.encode(
            [(each.target, each.session, each.phase, each.leaf, each.sim_time_s) for each in beats]
        ).decode()

    def find_beat(self, status: SessionStatus) -> Heartbeat | None:
        """The heartbeat of the worker that runs a session now."""
        beat = self.read_beats().get(status.contract.target)
        return beat if beat is not None and beat.session == status.contract.id else None

    def read_bundle(self, status: SessionStatus) -> Bundle:
        """The evidence of a session, as far as it is written; raises ExecutionError `EVIDENCE_DAMAGED`."""
        folder, execution = self.workspace.evidence_of(status.contract.id), status.execution
        key = (status.contract.id, status.updated_at, find_latest([folder / TRACE]))
        if key not in self._bundles:
            nothing = Execution(ended=Ended.COMPLETED, evidence=str(folder))  # only to read what there is so far
            self._bundles[key] = read_bundle(folder, status.contract, execution or nothing)
            for old in list(self._bundles)[:-BUNDLES_KEPT]:
                self._bundles.pop(old, None)
        return self._bundles[key]

    def read_world(self, status: SessionStatus | None) -> Environment | None:
        """The world as believed after a session, or before one that runs; of none, ENVIRONMENT.md."""
        if status is not None:
            bundle = self.read_bundle(status)
            return bundle.after or bundle.before
        path = self.workspace.environment
        return read_environment(read_regular(path).decode(), path.name) if path.is_file() else None


def find_latest(paths: list[Path]) -> int:
    """Latest change of any of these files and folders [ns], 0 where there are none."""
    stamps = []
    for path in paths:
        try:
            stamps.append(os.stat(path).st_mtime_ns)  # noqa: PTH116 - four times a second
        except OSError:
            continue
    return max(stamps, default=0)
