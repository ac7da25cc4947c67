"""LOG.md: what happened, one line a record that matters, in words; a record becomes words only when it is shown."""

from collections import deque
from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

from phyagentos.protocol.documents.log import LOG, LogFront, LogLine
from phyagentos.protocol.documents.markdown import flatten, format_time, render_front
from phyagentos.protocol.sessions.session import GoalId, SessionId, SessionStatus
from phyagentos.store.admission import GoalEvent
from phyagentos.store.ledger import Ledger, read_replan
from phyagentos.store.records import JOURNAL_ID, Record
from phyagentos.store.views.sessions import describe_attempt, describe_execution
from phyagentos.wording import count

NODES_NAMED = 10
LINES_SHOWN = 1000  # some hundred sessions; a person scrolls no further back

_HEAD = """# Log

One line an event, newest last: time (UTC), about what, by whom, what happened.

- **Written by** the renderer, from the journal in `sessions/`, which has every record whole.
- **An edit is lost** with the next rendering. To change something, edit `SESSIONS.md` or use `paos cancel`.
- **What the programs printed** is in `logs/`.

"""
_NOTHING = "Nothing has happened yet.\n"
_PLAIN = {
    "release": "let go, waiting again",
    "halt": "coming to rest",
    "amend": "amended",
    "request_cancel": "asked to end",
    "confirm_cancel": "at rest, cancelled",
    "lose": "runner or target lost, outcome unknown",
    "cancel": "cancelled",
    "reject": "rejected by preflight, nothing moved",
    GoalEvent.AMENDMENT_ASKED.value: "another graph was requested",
    GoalEvent.GOAL_AMENDED.value: "its graph has changed",
    GoalEvent.AMENDMENT_REFUSED.value: "the requested graph was refused",
    GoalEvent.NODE_READY.value: "ready",
    GoalEvent.NODE_DONE.value: "done",
    GoalEvent.NODE_BLOCKED.value: "cannot be done",
    GoalEvent.NODE_SKIPPED.value: "not taken",
    GoalEvent.NODE_RESCUED.value: "made up for",
    GoalEvent.INVALIDATED.value: "holds no longer",
    GoalEvent.NODE_WAITS.value: "waits",
    GoalEvent.BUDGET_SPENT.value: "counted as a replan",
    GoalEvent.GOAL_CANCELLED.value: "cancelled",
}
_SILENT = frozenset({"check", "halt", "verify"})
_NODE_ENDS = frozenset({GoalEvent.NODE_DONE.value, GoalEvent.NODE_BLOCKED.value})
_CHILD_OF = GoalEvent.CHILD_OF.value


class _Note(NamedTuple):
    """A record to show, the status of its session (None without one), and what the fold adds about a node."""

    record: Record
    status: SessionStatus | None
    hint: str


class LogTail:
    """The latest lines; a long run costs no more memory than a short one."""

    def __init__(self) -> None:
        self._lines: deque[tuple[int, LogLine]] = deque(maxlen=LINES_SHOWN)  # with the number of its record
        self._notes: deque[_Note] = deque(maxlen=LINES_SHOWN)  # what came since the last rendering

    def take(self, record: Record, ledger: Ledger) -> None:
        """Note one record; see `describe_record`."""
        if record.ev not in _SILENT:
            self._notes.append(_take_note(record, ledger))

    def render(self, seq: int) -> str:
        """LOG.md as of a record."""
        self._lines.extend((note.record.seq, _format(note)) for note in self._notes)
        self._notes.clear()
        older = self._lines[0][0] - 1 if self._lines else seq
        return render_log([line for _, line in self._lines], seq, older=older)


def render_log(lines: Sequence[LogLine], seq: int, *, older: int = 0) -> str:
    """LOG.md from its lines, oldest first; `older` counts the records before the first line."""
    front = render_front(LogFront(phy=LOG.phy, view=seq, older=older))
    note = f"{older} older records are not shown here; they are in `sessions/`.\n\n" if older else ""
    days = groupby(lines, key=lambda line: line.at[:10])
    shown = [f"## {day}\n\n{''.join(map(_render_line, each))}" for day, each in days]
    return f"{front}{_HEAD}{note}" + ("\n".join(shown) or _NOTHING)


def _take_note(record: Record, ledger: Ledger) -> _Note:
    if record.to is not None:
        return _Note(record, ledger.sessions.get(SessionId(record.id)), "")
    if record.ev in _NODE_ENDS:
        return _Note(record, None, _find_judged(record, ledger))
    return _Note(record, None, read_replan(record.body or {}).reason if record.ev == _CHILD_OF else "")


def _format(note: _Note) -> LogLine:
    record, status, hint = note
    about = record.id.removeprefix("goal:").removeprefix("node:")
    text = _format_session(record, status) if status is not None else _format_goal(record, hint)
    return LogLine(at=f"{record.at[:19]}Z", about=about, by=record.by, text=flatten(text))


def _render_line(line: LogLine) -> str:
    return f"- {format_time(line.at)} **{line.about}** ({line.by}) {line.text}\n"


def _format_session(record: Record, status: SessionStatus) -> str:
    body = record.body or {}
    match record.ev:
        case "submit":
            contract = status.contract
            revises = f", revises {contract.parent}" if contract.parent else ""
            return f"asks: {contract.objective} ({contract.skill} on {contract.target}{revises})"
        case "claim":
            return f"claimed, epoch {record.epoch}"
        case "start":
            return "passed preflight, running"
        case "finish" | "reconcile":
            return f"execution {describe_execution(status)}"
        case "accept" | "refuse" | "replan" if "attempt" in body:
            return f"verdict {describe_attempt(status.attempts[-1])}"
    return _with_reason(_PLAIN.get(record.ev, record.ev), body)


def _format_journal(record: Record, body: dict[str, object]) -> str:
    if record.ev == "lost":
        return "a record is lost; its number stays empty"
    if "cut_bytes" in body:
        place = f"{body.get('segment')}:{body.get('offset')}"
        return f"cut {body['cut_bytes']} bytes that a writer left half at {place}"
    return f"the journal was repaired: {body.get('lost', 0)} records are lost"


def _format_goal(record: Record, hint: str) -> str:
    body = record.body or {}
    if record.id == JOURNAL_ID:
        return _format_journal(record, body)
    match record.ev:
        case GoalEvent.GOAL_SUBMITTED:
            words = str(body.get("objective") or body.get("graph", "")).rstrip(".")
            return f"goal requested: {words}, seed {body.get('seed')}"
        case GoalEvent.GOAL_COMPILED:
            nodes = body.get("nodes", {})
            shown = ", ".join(list(nodes)[:NODES_NAMED]) + (", …" if len(nodes) > NODES_NAMED else "")
            return f"compiled into {count(len(nodes), 'node')}: {shown}"
        case GoalEvent.CHILD_OF:
            replan = read_replan(body)
            return f"{replan.session} continues as {replan.child}: {hint or replan.reason or 'as before'}"
        case GoalEvent.NODE_DONE | GoalEvent.NODE_BLOCKED:
            return _with_reason(_PLAIN[record.ev], {"reason": hint or body.get("reason")})
        case GoalEvent.GOAL_VERDICT:
            return _with_reason(f"goal verdict {body.get('verdict')}", body)
    return _with_reason(_PLAIN.get(record.ev, record.ev), body)


def _find_judged(record: Record, ledger: Ledger) -> str:
    """The session whose verdict is the reason, and its state, so that it is not shown twice; empty without one."""
    goal, _, node = record.id.removeprefix("node:").partition("/")
    status = ledger.goals.get(GoalId(goal))
    sessions = status.nodes[node].sessions if status is not None and node in status.nodes else ()
    latest = ledger.sessions.get(sessions[-1]) if sessions else None
    decision = latest.decision if latest is not None else None
    is_shown = decision is not None and decision.reason == (record.body or {}).get("reason")
    return f"{sessions[-1]} {latest.state}" if is_shown and latest is not None else ""


def _with_reason(text: str, body: dict[str, object]) -> str:
    return f"{text}: {body['reason']}" if body.get("reason") else text
