"""Proof of silence: nothing is accepted without authority, nothing after the end. Read from the target's own log.

    python -m tests.monitors.silence WORKSPACE...

The log of a target (`logs/receive-<target>.jsonl`) tells what the target itself accepted; the journal tells when a
session was `running`. Rules that need only the log (authority, sequence, epochs, state writes) are judged by the order
of its lines, and no clock is involved. Rules that need both files compare `at`: both are stamped on one machine by one
clock, the log when a request arrives, the journal before a record is written. A worker that is replaced is killed
before `lose` is recorded, and a session ends at the target before `finish` is recorded, so the order holds without
any allowance; `TOLERANCE_S` covers a slewed clock and the microseconds between two looks at one clock.

An emergency stop is told twice: by the target, where it stopped (`EStop`, then no command is accepted before another
session begins), and by the latch beside the signals, from when until when.

A session that is being cancelled is asked to stop: until the runtime's own limit for that (`STOP_GRACE_S`) has passed,
its commands bring it to its end. Upstream: a workspace. Downstream: every journey, benchmarks and CI.
"""

import datetime
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.protocol.sessions.estop import Latch
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.runtime.supervision.target_supervisor import STOP_GRACE_S
from phyagentos.runtime.supervision.watchdog import POLL_S
from phyagentos.store.follower import Follower
from phyagentos.store.records import Record

TOLERANCE_S = 0.02  # one control period
STOP_S = STOP_GRACE_S + POLL_S  # from the request to cancel until whoever does not stop is ended
MOVING = frozenset(
    {"Command", "Call", "Cancel", "Halt", "Settle"}
)  # what needs authority; the target decelerating by itself is no request
ENDING = frozenset({"End", "Withdraw"})
ESTOP_S = 1.0  # from the request until the target knows: far more than it takes, which is measured elsewhere


class Kind(StrEnum):
    """What must never be."""

    NOT_RUNNING = "not_running"
    """A command of a session that the journal does not show as running."""
    STALE_EPOCH = "stale_epoch"
    """Something under an epoch that a later one has replaced."""
    NO_AUTHORITY = "no_authority"
    """Something of a session that had ended, had lost its client, or while another one commands."""
    NEVER_BEGUN = "never_begun"
    """Something of a session that never took authority."""
    EMERGENCY_STOP = "emergency_stop"
    """A command while the emergency stop is latched."""
    OUT_OF_SEQUENCE = "out_of_sequence"
    """A command that does not follow the one before it."""
    STATE_WRITE = "state_write"
    """Simulator state was written after the episode's first session had begun."""
    UNREADABLE = "unreadable"
    """A line that no dying process leaves."""


@dataclass(frozen=True, slots=True)
class Violation:
    """One line of a receive log that must not be there.

    Attributes:
        place: `<file>:<line>`.
        because: One sentence.
    """

    kind: Kind
    place: str
    session: str
    because: str

    def __str__(self) -> str:
        """`receive-panda.jsonl:17: stale_epoch: g.a: ...`."""
        return f"{self.place}: {self.kind}: {self.session}: {self.because}"


@dataclass(frozen=True, slots=True)
class Span:
    """A time in which a session was running, under one epoch [s, UTC]."""

    epoch: int
    begin_s: float
    end_s: float


@dataclass(slots=True)
class Past:
    """What the journal tells of one session."""

    spans: list[Span] = field(default_factory=list)
    epochs: list[tuple[float, int]] = field(default_factory=list)  # since when which was in force


def find_violations(workspace: Path) -> list[Violation]:
    """Everything in the receive logs of a workspace that must not be there.

    Args:
        workspace: Its root. Without a journal (a rerun, a preflight) only the rules of the log itself are judged.
    """
    logs = {path: path.read_bytes() for path in sorted((workspace / "logs").glob("receive-*.jsonl"))}
    pasts = read_pasts(workspace)  # after the logs: whatever was accepted was recorded before
    stops = read_emergency_stops(workspace)
    return [found for path, data in logs.items() for found in LogMonitor(path.name, pasts, stops).judge(data)]


def count_commands(workspace: Path) -> int:
    """Commands that the targets of a workspace accepted; a proof over none proves nothing."""
    logs = (workspace / "logs").glob("receive-*.jsonl")
    return sum(
        line.get("kind") == "Command" and line.get("accepted", True)
        for path in logs
        for _, line in _iter_lines(path.read_bytes())
        if line is not None
    )


def read_pasts(workspace: Path) -> dict[str, Past] | None:
    """When each session was running, by the journal; None without a journal."""
    sessions = workspace / "sessions"
    lanes = [path for path in sessions.iterdir() if path.name != "archive"] if sessions.is_dir() else []
    pasts: dict[str, Past] = {}
    for lane in (path for path in lanes if path.is_dir()):
        follower = Follower(lane)
        for record in follower.read_new():
            if record.to is not None:
                _apply(pasts.setdefault(record.id, Past()), record)
        follower.close()
    return pasts if lanes else None


def read_emergency_stops(workspace: Path) -> list[tuple[float, float]]:
    """When the emergency stop was latched, and until when [s]."""
    files = sorted((workspace / "signals").glob("estop*.json"))
    latches = [msgspec.json.decode(path.read_bytes(), type=Latch) for path in files]
    return [
        (parse_s(latch.at), parse_s(latch.reset_at) if latch.reset_at else float("inf"))
        for latch in latches
        if latch.at
    ]


def _apply(past: Past, record: Record) -> None:
    at_s, epoch = parse_s(record.at), record.epoch or 0
    past.epochs.append((at_s, epoch))
    open_end = past.spans[-1] if past.spans and past.spans[-1].end_s > at_s else None
    if record.to == SessionState.RUNNING:
        past.spans.append(Span(epoch, at_s, float("inf")))
    elif open_end is not None and record.to != SessionState.HALTING:
        grace_s = STOP_S if record.to == SessionState.CANCELLING else 0.0
        past.spans[-1] = Span(open_end.epoch, open_end.begin_s, at_s + grace_s)


def parse_s(at: str) -> float:
    """A wall time of a record or a log [s]."""
    return datetime.datetime.fromisoformat(at).timestamp()


class LogMonitor:
    """Judges one receive log, line by line; what it remembers is what the target should.

    Args:
        name: Of the file.
        pasts: What the journal tells; None where there is none.
        stops: When the emergency stop was latched.
    """

    def __init__(self, name: str, pasts: Mapping[str, Past] | None, stops: Sequence[tuple[float, float]] = ()) -> None:
        self._name, self._pasts, self._stops = name, pasts, stops
        self._number = 0
        self._episode_begun = ""
        self._is_stopped = False
        self._seen: dict[str, int] = {}  # session -> largest epoch that began, over all processes
        self._start_process()

    def judge(self, data: bytes) -> Iterator[Violation]:
        """Every violation of a log."""
        lines = list(_iter_lines(data))
        for index, (number, line) in enumerate(lines):
            self._number = number
            if line is None:
                follower = lines[index + 1][1] if index + 1 < len(lines) else {"kind": "process_start"}
                if follower is None or follower.get("kind") != "process_start":
                    yield self._tell(Kind.UNREADABLE, {}, "half a line, and the same process went on")
            elif line.get("accepted", True):
                yield from self._judge_line(line)

    def _start_process(self) -> None:
        self._claim: tuple[str, int] | None = None
        self._begun: set[tuple[str, int]] = set()
        self._sequence = 0
        self._episode_begun = ""

    def _judge_line(self, line: Mapping[str, Any]) -> Iterator[Violation]:
        kind, claim = line["kind"], (line.get("session", ""), line.get("epoch", 0))
        if kind == "process_start":
            self._start_process()
        elif kind == "state_write":
            if line.get("episode", "") == self._episode_begun or self._claim is not None:
                yield self._tell(Kind.STATE_WRITE, line, f"episode {line.get('episode')} had begun")
        elif kind == "EStop":
            self._is_stopped = True
        elif kind == "Begin":
            yield from self._judge_begin(line, claim)
        elif kind in MOVING or kind == "End":
            yield from self._judge_authority(line, claim)
        if kind == "Command":
            yield from self._judge_command(line, claim)
        if kind in ENDING:
            self._claim = None

    def _judge_begin(self, line: Mapping[str, Any], claim: tuple[str, int]) -> Iterator[Violation]:
        if claim[1] < self._seen.get(claim[0], 0):
            yield self._tell(Kind.STALE_EPOCH, line, f"it began under epoch {claim[1]} after {self._seen[claim[0]]}")
        if self._claim is not None and claim != self._claim:
            yield self._tell(Kind.NO_AUTHORITY, line, f"it began while {self._claim[0]} had authority")
        if claim != self._claim and claim in self._begun:
            yield self._tell(Kind.NO_AUTHORITY, line, f"it began under epoch {claim[1]} a second time")
        self._seen[claim[0]] = max(claim[1], self._seen.get(claim[0], 0))
        self._claim, self._sequence, self._episode_begun = claim, 0, line.get("episode", "")
        self._begun.add(claim)
        self._is_stopped = False

    def _judge_authority(self, line: Mapping[str, Any], claim: tuple[str, int]) -> Iterator[Violation]:
        if claim[1] < self._seen.get(claim[0], 0):
            yield self._tell(Kind.STALE_EPOCH, line, f"epoch {claim[1]} after epoch {self._seen[claim[0]]} had begun")
        elif claim == self._claim:
            return
        elif claim in self._begun:
            yield self._tell(Kind.NO_AUTHORITY, line, f"{line['kind']} after its end")
        else:
            yield self._tell(Kind.NEVER_BEGUN, line, f"{line['kind']} without a Begin under epoch {claim[1]}")

    def _judge_command(self, line: Mapping[str, Any], claim: tuple[str, int]) -> Iterator[Violation]:
        sequence = line.get("sequence", 0)
        if claim == self._claim and sequence != self._sequence + 1:
            yield self._tell(Kind.OUT_OF_SEQUENCE, line, f"number {sequence} after {self._sequence}")
        self._sequence = sequence
        at_s = parse_s(line["at"]) if line.get("at") else float("nan")
        if self._is_stopped or any(begin_s + ESTOP_S < at_s < end_s for begin_s, end_s in self._stops):
            yield self._tell(Kind.EMERGENCY_STOP, line, "a command under a latched emergency stop")
        if self._pasts is not None and line.get("at"):
            yield from self._judge_by_journal(line, claim, at_s, self._pasts)

    def _judge_by_journal(
        self, line: Mapping[str, Any], claim: tuple[str, int], at_s: float, pasts: Mapping[str, Past]
    ) -> Iterator[Violation]:
        past = pasts.get(claim[0])
        if past is None:
            yield self._tell(Kind.NOT_RUNNING, line, "the journal knows no such session")
            return
        current = max((epoch for since_s, epoch in past.epochs if since_s < at_s - TOLERANCE_S), default=claim[1])
        if claim[1] < current:
            yield self._tell(Kind.STALE_EPOCH, line, f"epoch {claim[1]}, the journal had {current} by {line['at']}")
        spans = [span for span in past.spans if span.epoch == claim[1]]
        if not any(span.begin_s - TOLERANCE_S <= at_s <= span.end_s + TOLERANCE_S for span in spans):
            away_s = min((max(s.begin_s - at_s, at_s - s.end_s) for s in spans), default=float("nan"))
            yield self._tell(Kind.NOT_RUNNING, line, f"accepted at {line['at']}, {away_s:.3f} s from its running")

    def _tell(self, kind: Kind, line: Mapping[str, Any], because: str) -> Violation:
        return Violation(kind, f"{self._name}:{self._number}", line.get("session", ""), because)


def _iter_lines(data: bytes) -> Iterator[tuple[int, dict[str, Any] | None]]:
    """Number and content of each line; None for one that cannot be read."""
    for number, text in enumerate(data.split(b"\n"), 1):
        if not text:
            continue
        try:
            line = json.loads(text)
        except ValueError:
            line = None
        yield number, line if isinstance(line, dict) and "kind" in line else None


def main(roots: Sequence[str]) -> int:
    """Judge workspaces; 1 when anything was found, or nothing was commanded."""
    code = 0
    for root in map(Path, roots):
        found, commands = find_violations(root), count_commands(root)
        print(f"{root}: {commands} commands accepted, {len(found)} violations")  # noqa: T201 - a command
        for violation in found:
            print(f"  {violation}")  # noqa: T201 - a command
        code |= bool(found) or not commands
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
