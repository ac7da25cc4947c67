"""The session's statechart: one table is the code, the documentation and the test model. Paper section 3.5.

`transitions` compiles the table once, without auto transitions; sessions are never registered as models. Each row names
the side that may fire it, and a trigger from the wrong side is refused.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import TYPE_CHECKING

from phyagentos.errors import PhyAgentOSError

if TYPE_CHECKING:
    from transitions import Machine


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
    """An end was asked for; the target is being brought to rest."""
    OUTCOME_UNKNOWN = "outcome_unknown"
    """The runner or the target was lost; only a fresh observation leads on."""
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


FINAL_STATES = frozenset(
    {
        SessionState.SUCCEEDED,
        SessionState.FAILED,
        SessionState.REPLANNED,
        SessionState.UNVERIFIED,
        SessionState.REJECTED,
        SessionState.CANCELLED,
    }
)


class Side(StrEnum):
    """Who may fire a trigger."""

    AGENT = "agent"
    RUNTIME = "runtime"
    OPERATOR = "operator"


REVIEW = "review"  # adds a judgement to a session that has its verdict, and changes nothing else


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table: `trigger` leads from each of `sources` to `dest`, fired by one of `by`."""

    trigger: str
    sources: tuple[SessionState, ...]
    dest: SessionState
    by: tuple[Side, ...]


_S = SessionState
_HELD = (_S.CLAIMED, _S.PREFLIGHT, _S.RUNNING, _S.HALTING)
_JUDGED = (_S.SUCCEEDED, _S.FAILED, _S.REPLANNED, _S.UNVERIFIED)  # final, and there is evidence to judge again
_ANY = (Side.AGENT, Side.RUNTIME, Side.OPERATOR)

SESSION_TRANSITIONS: tuple[Row, ...] = (
    Row("amend", (_S.PENDING,), _S.PENDING, (Side.OPERATOR,)),
    Row("claim", (_S.PENDING,), _S.CLAIMED, (Side.RUNTIME,)),
    Row("release", (_S.CLAIMED, _S.PREFLIGHT), _S.PENDING, (Side.RUNTIME,)),
    Row("check", (_S.CLAIMED,), _S.PREFLIGHT, (Side.RUNTIME,)),
    Row("reject", (_S.PENDING, _S.CLAIMED, _S.PREFLIGHT), _S.REJECTED, (Side.RUNTIME,)),
    Row("start", (_S.CLAIMED, _S.PREFLIGHT), _S.RUNNING, (Side.RUNTIME,)),
    Row("halt", (_S.RUNNING,), _S.HALTING, (Side.RUNTIME,)),
    Row("finish", (_S.RUNNING, _S.HALTING), _S.AWAITING_VERIFICATION, (Side.RUNTIME,)),
    Row("verify", (_S.AWAITING_VERIFICATION,), _S.VERIFYING, (Side.AGENT,)),
    Row("accept", (_S.VERIFYING,), _S.SUCCEEDED, (Side.AGENT,)),
    Row("refuse", (_S.VERIFYING,), _S.FAILED, (Side.AGENT,)),
    Row("replan", (_S.VERIFYING,), _S.REPLANNED, (Side.AGENT,)),
    Row("skip", (_S.VERIFYING,), _S.UNVERIFIED, (Side.AGENT,)),
    *(Row(REVIEW, (state,), state, (Side.AGENT,)) for state in _JUDGED),
    Row("cancel", (_S.PENDING, _S.AWAITING_VERIFICATION, _S.VERIFYING), _S.CANCELLED, _ANY),
    Row("request_cancel", _HELD, _S.CANCELLING, _ANY),
    Row("confirm_cancel", (_S.CANCELLING,), _S.CANCELLED, (Side.RUNTIME,)),
    Row("lose", (*_HELD, _S.CANCELLING), _S.OUTCOME_UNKNOWN, (Side.RUNTIME,)),
    Row("reconcile", (_S.OUTCOME_UNKNOWN,), _S.AWAITING_VERIFICATION, (Side.RUNTIME,)),
)


class IllegalTransition(PhyAgentOSError):
    """A trigger that the table does not allow.

    Attributes:
        session_id: The session.
        state: Where it stood.
        trigger: What was asked.
        side: Who asked.
        allowed: Triggers that would have been possible from there, for any side.
    """

    def __init__(self, session_id: str, state: str, trigger: str, side: str, allowed: tuple[str, ...]) -> None:
        self.session_id, self.state, self.trigger, self.side, self.allowed = session_id, state, trigger, side, allowed
        is_final = state in FINAL_STATES
        possible = ", ".join(allowed) or "none"
        possible += ", the state is final" if is_final else ""
        super().__init__(
            f"session {session_id}: {side} asked for {trigger!r} in state {state!r}. Possible: {possible}. "
            "A change of mind about a final session is a new child session."
        )


@cache
def build_machine() -> "Machine":
    """The one shared `transitions` machine; it holds no model."""
    from transitions import Machine  # late: who only reads needs no machine

    return Machine(
        model=None,
        states=[state.value for state in SessionState],
        transitions=[
            {"trigger": row.trigger, "source": [source.value for source in row.sources], "dest": row.dest.value}
            for row in SESSION_TRANSITIONS
        ],
        initial=SessionState.PENDING.value,
        auto_transitions=False,
        send_event=True,
        queued=False,
    )


@cache
def compile_table() -> dict[tuple[str, str], str]:
    """`(source, trigger) -> dest`, read from the machine, for admission checks and replay."""
    return {
        (source, name): str(transition.dest)
        for name, event in build_machine().events.items()
        for source, transitions in event.transitions.items()
        for transition in transitions
    }


@cache
def _sides() -> dict[str, frozenset[str]]:
    return {row.trigger: frozenset(side.value for side in row.by) for row in SESSION_TRANSITIONS}


def compute_next_state(session_id: str, state: str, trigger: str, side: str) -> str:
    """Where `trigger`, fired by `side`, leads from `state`.

    Raises:
        IllegalTransition: When the table has no such row, or not for this side.
    """
    dest = compile_table().get((state, trigger))
    if dest is None or side not in _sides()[trigger]:
        allowed = tuple(sorted(name for source, name in compile_table() if source == state))
        raise IllegalTransition(session_id, state, trigger, side, allowed)
    return dest


def find_cancel(state: str) -> str | None:
    """The trigger that asks for an end: at once, or once the target is at rest; None where neither is possible."""
    return next((trigger for trigger in ("cancel", "request_cancel") if (state, trigger) in compile_table()), None)


def render_mermaid() -> str:
    """The statechart as a Mermaid diagram; each arrow carries its trigger and who may fire it."""
    lines = ["stateDiagram-v2", f"    [*] --> {SessionState.PENDING}: submit (agent, operator)"]
    for row in SESSION_TRANSITIONS:
        sides = ", ".join(side.value for side in row.by)
        lines += [f"    {source} --> {row.dest}: {row.trigger} ({sides})" for source in row.sources]
    lines += [f"    {state} --> [*]" for state in SessionState if state in FINAL_STATES]
    return "\n".join(lines) + "\n"
