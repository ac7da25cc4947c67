"""A goal over time: its sessions as bars, a lane for each target, with what led from one to another and what happened.

All from records and evidence. Records have wall times. What evidence holds in simulated time is placed in between,
evenly over the time in which its session ran.
"""

import contextlib
import datetime
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby

from phyagentos.clock import compute_seconds
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.evidence import TAKEN_OVER
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions.looks import read_looks
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus, Relation, get_step_name
from phyagentos.view.documents import Documents

BARS_MARKED = 40  # with more, evidence is not read for marks, and neighbours that are too narrow to hit are one bar
SLIVER = 0.01  # of the whole time: what is too narrow
TICKS = 8  # of the axis, at most
_ROUND_S = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600, 86400)
_S = SessionState
_PHASES = {
    **dict.fromkeys((_S.CLAIMED, _S.PREFLIGHT), "checking"),
    **dict.fromkeys((_S.RUNNING, _S.HALTING, _S.CANCELLING, _S.OUTCOME_UNKNOWN), "running"),
    **dict.fromkeys((_S.AWAITING_VERIFICATION, _S.VERIFYING), "judging"),
}


@dataclass(frozen=True, slots=True)
class Span:
    """A part of the time of a session: `checking`, `running` or `judging`, since the goal was submitted [s]."""

    phase: str
    from_s: float
    to_s: float


@dataclass(frozen=True, slots=True)
class Mark:
    """A moment: a `look` of the cameras, a `guard` that intervened, a `person` who took over, a `request`."""

    kind: str
    at_s: float
    text: str


@dataclass(frozen=True, slots=True)
class Bar:
    """One session; of many that are too narrow to hit, some neighbours of one state.

    Attributes:
        name: Its id without the goal.
        spans: Growing, one after another; empty while it waits.
        sim_s: First and last simulated time of what it ran; equal where that is not known.
        number: Of sessions, the first of which `status` is.
    """

    status: SessionStatus
    name: str
    spans: tuple[Span, ...]
    marks: tuple[Mark, ...] = ()
    sim_s: tuple[float, float] = (0.0, 0.0)
    number: int = 1

    @property
    def from_s(self) -> float:
        """Wall time of its claim."""
        return self.spans[0].from_s

    @property
    def to_s(self) -> float:
        """Wall time of its end."""
        return self.spans[-1].to_s

    @property
    def ran(self) -> Span:
        """When it ran; without that, the whole."""
        found = [each for each in self.spans if each.phase == "running"]
        return Span("running", *((found[0].from_s, found[-1].to_s) if found else (self.from_s, self.to_s)))


@dataclass(frozen=True, slots=True)
class Link:
    """What led from one session to another: the lanes and times of both."""

    relation: Relation
    before: Bar
    after: Bar


@dataclass(frozen=True, slots=True)
class Timeline:
    """One goal.

    Attributes:
        began: Wall time of its submission, UTC.
        length_s: Until its latest record, or the latest heartbeat while something runs.
        lanes: Target -> its bars.
        waiting: Sessions that no worker has claimed yet.
        requests: Of operators.
    """

    began: str
    length_s: float
    lanes: dict[str, list[Bar]]
    waiting: list[Bar]
    links: list[Link]
    requests: list[Mark]

    @property
    def ticks(self) -> list[float]:
        """Times of the axis [s]."""
        step_s = next((each for each in _ROUND_S if self.length_s / each <= TICKS), self.length_s)
        return [number * step_s for number in range(int(self.length_s / step_s) + 1)] if step_s else [0.0]

    def share(self, at_s: float) -> float:
        """A time as a share of the whole [%]."""
        return round(100.0 * min(max(at_s / self.length_s, 0.0), 1.0), 3) if self.length_s else 0.0

    def stamp(self, at_s: float) -> float:
        """A time since the epoch [ms]."""
        return 1e3 * (datetime.datetime.fromisoformat(self.began).timestamp() + at_s)


def measure_length(documents: Documents, goal: GoalStatus) -> tuple[str, float]:
    """When a goal was submitted, and its time until the latest record or heartbeat [s]; reads no evidence."""
    sessions = _list_sessions(documents, goal)
    passages = [each.at for status in sessions for each in documents.passages[status.contract.id]]
    began = goal.submitted_at or min(passages, default=goal.updated_at)
    ends = [*passages, goal.updated_at]
    if any(each.state not in FINAL_STATES and each.claimed_by for each in sessions):
        beat = datetime.datetime.fromtimestamp(documents.version.beats / 1e9, datetime.UTC)
        ends.append(beat.isoformat(timespec="microseconds").replace("+00:00", "Z"))
    return began, compute_seconds(began, max(ends)) if began else 0.0


def _list_sessions(documents: Documents, goal: GoalStatus) -> list[SessionStatus]:
    return [each for each in documents.ledger.sessions.values() if each.contract.goal == goal.id]


def read_timeline(documents: Documents, goal: GoalStatus, chosen: str = "") -> Timeline:
    """The timeline of a goal so far; the chosen session has a bar of its own."""
    sessions, (began, length_s) = _list_sessions(documents, goal), measure_length(documents, goal)
    bars = [_read_bar(documents, status, began, length_s, marks=len(sessions) <= BARS_MARKED) for status in sessions]
    lanes: dict[str, list[Bar]] = {}
    for bar in bars:
        if bar.spans:
            lanes.setdefault(bar.status.contract.target, []).append(bar)
    if len(sessions) > BARS_MARKED:
        lanes = {target: _fold(row, SLIVER * length_s, chosen) for target, row in lanes.items()}
    by_id = {bar.status.contract.id: bar for bar in bars if bar.spans}
    links = [
        Link(each.relation, by_id[each.session], by_id[each.child])
        for node in goal.nodes.values()
        for each in node.replans
        if each.session in by_id and each.child in by_id
    ]
    own = {*by_id, f"goal:{goal.id}"}
    requests = [
        Mark("request", compute_seconds(began, each.at), f"{each.ev} by {each.by}")
        for each in documents.requests
        if each.id in own
    ]
    waiting = [bar for bar in bars if not bar.spans]
    return Timeline(began, length_s, dict(sorted(lanes.items())), waiting, links, requests)


def _fold(bars: list[Bar], narrow_s: float, chosen: str) -> list[Bar]:
    """Neighbours of one state that are narrow together as one bar; the chosen session alone."""
    folded: list[Bar] = []
    for bar in sorted(bars, key=lambda each: each.from_s):
        last = folded[-1] if folded else bar
        is_alike = last.status.state == bar.status.state and chosen not in (
            last.status.contract.id,
            bar.status.contract.id,
        )
        if last is not bar and is_alike and bar.to_s - last.from_s <= narrow_s:
            name, end_s = last.name.partition(" … ")[0], max(last.to_s, bar.to_s)
            span = Span("running", last.from_s, end_s)
            folded[-1] = replace(last, name=f"{name} … {bar.name}", spans=(span,), number=last.number + 1)
        else:
            folded.append(bar)
    return folded


def _read_bar(documents: Documents, status: SessionStatus, began: str, length_s: float, *, marks: bool) -> Bar:
    entered = [(each.state, compute_seconds(began, each.at)) for each in documents.passages[status.contract.id]]
    ends = [at_s for _, at_s in entered[1:]] + [length_s]
    states = [
        Span(_PHASES.get(SessionState(state), ""), from_s, to_s)
        for (state, from_s), to_s in zip(entered, ends, strict=True)
    ]
    runs = ((phase, [*same]) for phase, same in groupby(states, key=lambda each: each.phase))
    spans = tuple(Span(phase, same[0].from_s, same[-1].to_s) for phase, same in runs if phase)
    if not spans and status.state in FINAL_STATES:
        spans = (Span("checking", entered[-1][1], entered[-1][1]),)
    bar = Bar(status, get_step_name(status.contract.goal, status.contract.id), spans)
    if not marks or not spans or status.execution is None:
        return bar
    with contextlib.suppress(ExecutionError, OSError):  # its own panels say what is wrong with its evidence
        bundle = documents.read_bundle(status)
        first_s = bundle.before.time_s if bundle.before is not None else 0.0
        sim_s = (first_s, first_s + status.execution.sim_time_s)
        return Bar(status, bar.name, spans, tuple(_iter_marks(documents, bar, sim_s)), sim_s)
    return bar


def _iter_marks(documents: Documents, bar: Bar, sim_s: tuple[float, float]) -> Iterator[Mark]:
    folder = documents.workspace.evidence_of(bar.status.contract.id)
    looks = [(each.time_s, "look", f"look ({each.role})") for each in read_looks(folder)]
    guard = [(each.time_s, "guard", f"guard: {each.code}") for each in documents.read_bundle(bar.status).interventions]
    person = [
        (each.time_s, "person", f"taken over by {each.details.get('by', '?')}")
        for each in documents.read_bundle(bar.status).events
        if each.kind == TAKEN_OVER
    ]
    for time_s, kind, text in (*looks, *guard, *person):
        share = min(max((time_s - sim_s[0]) / max(sim_s[1] - sim_s[0], 1e-9), 0.0), 1.0)
        at_s = bar.ran.from_s + share * (bar.ran.to_s - bar.ran.from_s)
        yield Mark(kind, at_s, f"{text} at {time_s:.2f} s simulated")
