"""LOG.md: what happened, one line a record that matters, in words.

Upstream: records of a follower. Downstream: people.
"""

from collections.abc import Sequence
from typing import Any

import msgspec

from phyagentos.protocol.markdown import format_time
from phyagentos.protocol.sessions import SessionId, SessionStatus
from phyagentos.protocol.store.admission import GoalEvent
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.protocol.store.records import JOURNAL_ID, Record
from phyagentos.protocol.verdicts import Attempt
from phyagentos.protocol.views.sessions import describe_attempt, describe_execution

LINES_SHOWN = 2000

_HEAD = """# Log

One line an event, newest last: time (UTC), about what, by whom, what. A view of the journal in `sessions/`.

"""
_PLAIN = {
    "release": "let go, waiting again",
    "halt": "coming to rest",
    "request_cancel": "asked to end",
    "confirm_cancel": "at rest, cancelled",
    "lose": "runner or target lost, outcome unknown",
    "cancel": "cancelled",
    "reject": "rejected by preflight, nothing moved",
    GoalEvent.NODE_READY.value: "ready",
    GoalEvent.NODE_DONE.value: "done",
    GoalEvent.NODE_BLOCKED.value: "cannot be done",
    GoalEvent.INVALIDATED.value: "holds no longer",
    GoalEvent.BUDGET_SPENT.value: "a replan was paid for",
    GoalEvent.GOAL_CANCELLED.value: "cancelled",
}
_SILENT = frozenset({"check", "verify"})


def render_log(lines: Sequence[str], seq: int) -> str:
    """LOG.md from lines of `describe_record`; of a long story the end.

    Args:
        lines: All of them.
        seq: Sequence number of the last record.
    """
    hidden = len(lines) - LINES_SHOWN
    note = f"{hidden} older lines are not shown; the journal has them all.\n\n" if hidden > 0 else ""
    return f"---\nview: {seq}\n---\n\n{_HEAD}{note}" + "".join(lines[-LINES_SHOWN:])


def describe_record(record: Record, ledger: Ledger) -> str:
    """One line for people, or an empty string for a record that says nothing new to them.

    Args:
        record: The one applied last.
        ledger: The fold, this record included.
    """
    if record.ev in _SILENT:
        return ""
    body = record.body or {}
    status = ledger.sessions.get(SessionId(record.id))
    about = record.id.removeprefix("goal:").removeprefix("node:")
    text = _tell_session(record, body, status) if status is not None else _tell_goal(record, body)
    return f"- {format_time(record.at)} **{about}** ({record.by}) {' '.join(text.split())}\n"


def _tell_session(record: Record, body: dict[str, Any], status: SessionStatus) -> str:
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
            return f"verdict {describe_attempt(msgspec.convert(body['attempt'], Attempt))}"
    return _with_reason(_PLAIN.get(record.ev, record.ev), body)


def _tell_goal(record: Record, body: dict[str, Any]) -> str:
    if record.id == JOURNAL_ID:
        return (
            f"cut {body.get('cut_bytes')} bytes that a writer left half at {body.get('segment')}:{body.get('offset')}"
        )
    match record.ev:
        case GoalEvent.GOAL_SUBMITTED:
            return f"goal asked for: {body.get('objective') or body.get('graph', '')}, seed {body.get('seed')}"
        case GoalEvent.GOAL_COMPILED:
            return f"compiled into {len(body.get('nodes', ()))} nodes"
        case GoalEvent.CHILD_OF:
            return _with_reason(f"continues as {body.get('child')}, child of {body.get('parent')}", body)
        case GoalEvent.GOAL_VERDICT:
            return _with_reason(f"goal verdict {body.get('verdict')}", body)
    return _with_reason(_PLAIN.get(record.ev, record.ev), body)


def _with_reason(text: str, body: dict[str, Any]) -> str:
    return f"{text}: {body['reason']}" if body.get("reason") else text
