"""The session's statechart: one table is the code, the documentation and the test model. Paper section 3.5.

The conditions are in the machine: each row names the sides that may fire it, a record of the runtime carries the epoch
of its claim, and a final state is never left.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any

from phyagentos.errors import PhyAgentOSError
from phyagentos.protocol.sessions.statechart import Condition, Row, Statechart, render_rows


class SessionState(StrEnum):
    """Where a session stands."""

    PENDING = "pending"
    """Submitted, waiting for its target."""
    CLAIMED = "claimed"
    """A watchdog holds it under a lease and an epoch."""
    PREFLIGHT = "preflight"
    """Its contract is being checked against skill, target and world."""
    RUNNING = "running"
    """The runner has authority over the target."""
    HALTING = "halting"
    """The target is being brought to rest and observed."""
    AWAITING_VERIFICATION = "awaiting_verification"
    """Evidence is complete; a verdict is awaited."""
    VERIFYING = "verifying"
    """The verifier is judging."""
    CANCELLING = "cancelling"
    """Cancellation was requested; the target is being brought to rest."""
    OUTCOME_UNKNOWN = "outcome_unknown"
    """The runner or the target was lost; a fresh observation leads on, or the report that none can be made."""
    SUCCEEDED = "succeeded"
    """The objective was met on evidence. Final."""
    FAILED = "failed"
    """The objective was not met. Final."""
    REPLANNED = "replanned"
    """A child session continues. Final."""
    UNVERIFIED = "unverified"
    """Executed but not judged, because verification is off; no success. Final."""
    REJECTED = "rejected"
    """Preflight refused it; nothing moved. Final."""
    CANCELLED = "cancelled"
    """Ended on request. Final."""


class Side(StrEnum):
    """Who may fire a trigger."""

    AGENT = "agent"
    RUNTIME = "runtime"
    OPERATOR = "operator"


CLAIM = "claim"  # begins a new epoch
REVIEW = "review"  # adds a judgement to a session that has its verdict, and changes nothing else

_S = SessionState
_HELD = (_S.PREFLIGHT, _S.RUNNING, _S.HALTING)
_JUDGED = (_S.SUCCEEDED, _S.FAILED, _S.REPLANNED, _S.UNVERIFIED)  # final, and there is evidence to judge again
_ANY = (Side.AGENT, Side.RUNTIME, Side.OPERATOR)
UNJUDGED_STATES = frozenset({_S.AWAITING_VERIFICATION, _S.VERIFYING})
FINAL_STATES = frozenset({*_JUDGED, _S.REJECTED, _S.CANCELLED})

SESSION_TRANSITIONS: tuple[Row, ...] = (
    Row("amend", (_S.PENDING,), _S.PENDING, (Side.OPERATOR,)),
    Row(CLAIM, (_S.PENDING,), _S.CLAIMED, (Side.RUNTIME,)),
    Row("check", (_S.CLAIMED,), _S.PREFLIGHT, (Side.RUNTIME,)),
    Row("release", (_S.PREFLIGHT,), _S.PENDING, (Side.RUNTIME,)),
    Row("reject", (_S.PENDING, _S.PREFLIGHT), _S.REJECTED, (Side.RUNTIME,)),
    Row("start", (_S.PREFLIGHT,), _S.RUNNING, (Side.RUNTIME,)),
    Row("halt", (_S.RUNNING,), _S.HALTING, (Side.RUNTIME,)),
    Row("finish", (_S.HALTING,), _S.AWAITING_VERIFICATION, (Side.RUNTIME,)),
    Row("verify", (_S.AWAITING_VERIFICATION,), _S.VERIFYING, (Side.AGENT,)),
    Row("accept", (_S.VERIFYING,), _S.SUCCEEDED, (Side.AGENT,)),
    Row("refuse", (_S.VERIFYING,), _S.FAILED, (Side.AGENT,)),
    Row("replan", (_S.VERIFYING,), _S.REPLANNED, (Side.AGENT,)),
    Row("skip", (_S.VERIFYING,), _S.UNVERIFIED, (Side.AGENT,)),
    *(Row(REVIEW, (state,), state, (Side.AGENT,)) for state in _JUDGED),
    Row("cancel", (_S.PENDING, _S.AWAITING_VERIFICATION), _S.CANCELLED, _ANY),
    Row("request_cancel", _HELD, _S.CANCELLING, _ANY),
    Row("confirm_cancel", (_S.CANCELLING,), _S.CANCELLED, (Side.RUNTIME,)),
    Row("lose", (*_HELD, _S.CANCELLING), _S.OUTCOME_UNKNOWN, (Side.RUNTIME,)),
    Row("reconcile", (_S.OUTCOME_UNKNOWN,), _S.AWAITING_VERIFICATION, (Side.RUNTIME,)),
)

_RECORDED_EARLIER = "recorded earlier"
EARLIER_TRANSITIONS: tuple[Row, ...] = (
    Row("release", (_S.CLAIMED,), _S.PENDING, (Side.RUNTIME,), _RECORDED_EARLIER),
    Row("reject", (_S.CLAIMED,), _S.REJECTED, (Side.RUNTIME,), _RECORDED_EARLIER),
    Row("start", (_S.CLAIMED,), _S.RUNNING, (Side.RUNTIME,), _RECORDED_EARLIER),
    Row("finish", (_S.RUNNING,), _S.AWAITING_VERIFICATION, (Side.RUNTIME,), _RECORDED_EARLIER),
    Row("cancel", (_S.VERIFYING,), _S.CANCELLED, _ANY, _RECORDED_EARLIER),
    Row("request_cancel", (_S.CLAIMED,), _S.CANCELLING, _ANY, _RECORDED_EARLIER),
    Row("lose", (_S.CLAIMED,), _S.OUTCOME_UNKNOWN, (Side.RUNTIME,), _RECORDED_EARLIER),
)
"""Rows of journals before `preflight` and `halting` were entered: read and checked, never recorded again."""


class IllegalTransition(PhyAgentOSError):
    """A trigger that the table does not allow; `allowed` are those of any side from that state."""

    def __init__(self, session_id: str, state: str, trigger: str, side: str, allowed: tuple[str, ...]) -> None:
        self.session_id, self.state, self.trigger, self.side, self.allowed = session_id, state, trigger, side, allowed
        possible = ", ".join(allowed) or "none"
        if state in FINAL_STATES:
            possible += ", the state is final. A change of mind about a final session is a new child session"
        super().__init__(
            f"session {session_id}: {side} asked for {trigger!r} in state {state!r}. Possible: {possible}."
        )


class Fenced(PhyAgentOSError):
    """A trigger with a stale `epoch`: another claim, of epoch `current`, holds the session."""

    def __init__(self, session_id: str, trigger: str, epoch: int, current: int) -> None:
        self.session_id, self.trigger, self.epoch, self.current = session_id, trigger, epoch, current
        super().__init__(
            f"session {session_id}: {trigger!r} came with epoch {epoch}, but epoch {current} is in force. "
            "Another claim holds it now; the sender of this must stop."
        )


@dataclass(slots=True)
class SessionEvent:
    """One event of one session, on which the machine fires.

    Attributes:
        state: Where it stands; after `fire`, where the event led.
        epoch: Fencing token in force; after `fire`, the one from now on.
        token: Epoch under which the caller acts; None where there is none.
        is_past: Whether it was recorded already, and is only checked.
    """

    session_id: str
    state: str
    epoch: int
    trigger: str
    side: str
    token: int | None = None
    is_past: bool = False

    def has_epoch(self) -> bool:
        """Whether it carries the claim in force; only the runtime holds claims."""
        return self.side != Side.RUNTIME or self.token is None or self.token == self.epoch


def _find_condition(row: Row) -> Condition:
    sides, is_earlier = frozenset(map(str, row.by)), row.when == _RECORDED_EARLIER

    def may_fire(event: Any) -> bool:
        asked, before = event.model, event.state.name
        keeps_final_state = before not in FINAL_STATES or before == row.dest
        is_current = asked.is_past or not is_earlier
        return asked.side in sides and keeps_final_state and is_current and asked.has_epoch()

    return may_fire


@cache
def build_statechart() -> Statechart:
    """The one machine of all sessions."""
    return Statechart(SessionState, (*SESSION_TRANSITIONS, *EARLIER_TRANSITIONS), _find_condition)


def fire(event: SessionEvent) -> SessionEvent:
    """Fire one event; its state and epoch become those that it leads to.

    Raises:
        Fenced: It carries a stale epoch.
        IllegalTransition: The table has no such row, or not for this side.
    """
    if build_statechart().fire(event, event.trigger):
        event.epoch += event.trigger == CLAIM
        return event
    if not event.has_epoch():
        raise Fenced(event.session_id, event.trigger, event.token or 0, event.epoch)
    raise IllegalTransition(event.session_id, event.state, event.trigger, event.side, list_triggers(event.state))


@cache
def list_triggers(state: str) -> tuple[str, ...]:
    """Triggers that are possible from a state, for any side; sorted."""
    return tuple(sorted(row.trigger for row in SESSION_TRANSITIONS if state in row.sources))


def find_cancel(state: str) -> str | None:
    """The trigger that asks for an end: at once, or once the target is at rest; None where neither is possible."""
    return next((trigger for trigger in ("cancel", "request_cancel") if trigger in list_triggers(state)), None)


@cache
def render_mermaid() -> str:
    """The statechart as a Mermaid diagram; each arrow carries its trigger and its sides."""
    lines = ["stateDiagram-v2", f"    [*] --> {SessionState.PENDING}: submit (agent, operator)"]
    lines += render_rows(SESSION_TRANSITIONS)
    lines += [f"    {state} --> [*]" for state in SessionState if state in FINAL_STATES]
    return "\n".join(lines) + "\n"
