"""Which records may be added: the lifecycle of sessions, fencing by epoch, and who may say what about goals.

Upstream: the writer, which asks with the lane locked; so a check and the write that follows it are one step (the
compare-and-set of the store). Downstream: `lifecycle`. It holds two short facts per session and nothing of its content.
"""

from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import msgspec

from phyagentos.errors import DefinitionError, PhyAgentOSError, Problem, format_hint, format_names
from phyagentos.protocol.lifecycle import IllegalTransition, SessionState, Side, compute_next_state
from phyagentos.protocol.sessions import Session
from phyagentos.protocol.store.records import JOURNAL_ID, Record

GOAL_PREFIX = "goal:"
NODE_PREFIX = "node:"
_UNKNOWN = "unknown"  # state of a session that nobody has submitted


class GoalEvent(StrEnum):
    """What can be said about a goal (`goal:<goal id>`) or one of its nodes (`node:<goal id>/<node>`)."""

    GOAL_SUBMITTED = "goal_submitted"
    """A person asked for it; the first record of every goal."""
    GOAL_COMPILED = "goal_compiled"
    """Its graph is known."""
    NODE_READY = "node_ready"
    """Everything the node waits for is done."""
    CHILD_OF = "child_of"
    """A child session continues the node."""
    NODE_DONE = "node_done"
    """A session of the node succeeded."""
    NODE_BLOCKED = "node_blocked"
    """The node cannot be done."""
    INVALIDATED = "invalidated"
    """What the node achieved no longer holds."""
    BUDGET_SPENT = "budget_spent"
    """A replan was paid for."""
    GOAL_VERDICT = "goal_verdict"
    """Whether the goal was met; the last record of every goal."""
    GOAL_CANCELLED = "goal_cancelled"
    """Somebody asked for an end."""


_OF_GOALS = frozenset(
    {
        GoalEvent.GOAL_SUBMITTED,
        GoalEvent.GOAL_COMPILED,
        GoalEvent.BUDGET_SPENT,
        GoalEvent.GOAL_VERDICT,
        GoalEvent.GOAL_CANCELLED,
    }
)
_OF_NODES = frozenset(GoalEvent) - _OF_GOALS | {GoalEvent.BUDGET_SPENT}
_BY_OPERATOR = frozenset({GoalEvent.GOAL_SUBMITTED, GoalEvent.GOAL_CANCELLED})


class Entry(msgspec.Struct, frozen=True):
    """What somebody wants recorded.

    Attributes:
        id: A session id, `goal:<goal id>` or `node:<goal id>/<node>`.
        ev: `submit`, a trigger of the lifecycle, or a `GoalEvent`.
        body: The contract for `submit`; `execution` for `finish`; `attempt` for `accept`, `refuse`, `replan`;
            `reason` for `reject`, `cancel`, `lose`; for goals see `ledger`.
        epoch: The fencing token the caller acts under; None where there is none. With `claim`: the epoch it saw.
    """

    id: str
    ev: str
    body: dict[str, Any] | None = None
    epoch: int | None = None


class Fenced(PhyAgentOSError):
    """Somebody who no longer holds a session tried to speak for it.

    Attributes:
        session_id: The session.
        trigger: What was asked.
        epoch: The token it came with.
        current: The token in force.
    """

    def __init__(self, session_id: str, trigger: str, epoch: int, current: int) -> None:
        self.session_id, self.trigger, self.epoch, self.current = session_id, trigger, epoch, current
        super().__init__(
            f"session {session_id}: {trigger!r} came with epoch {epoch}, but epoch {current} is in force. "
            "Somebody else holds it now; whoever sent this must stop."
        )


class IllegalEvent(PhyAgentOSError):
    """A goal or node event that cannot be recorded.

    Attributes:
        id: The goal or node.
        event: What was to be recorded.
        reason: Why not.
    """

    def __init__(self, id: str, event: str, reason: str) -> None:
        self.id, self.event, self.reason = id, event, reason
        super().__init__(f"{id}: {event!r} refused: {reason}")


class Admission:
    """Judges entries against everything recorded so far."""

    def __init__(self) -> None:
        self._sessions: dict[str, tuple[str, int]] = {}  # id -> (state, epoch)
        self._goals: dict[str, str] = {}  # goal id -> latest goal event that matters here

    def apply(self, record: Record) -> None:
        """Take note of a record."""
        if record.to is not None:
            self._sessions[record.id] = (record.to, record.epoch or 0)
        elif record.id.startswith(GOAL_PREFIX) and record.ev in _OF_GOALS:
            self._goals[record.id[len(GOAL_PREFIX) :]] = record.ev

    def admit(
        self, entries: Sequence[Entry], markdown: Sequence[str], *, last_seq: int, by: str, side: Side, at: str
    ) -> list[Record]:
        """The records these entries become, each checked as if those before it stood already.

        Args:
            entries: One batch.
            markdown: The body of each, rendered.
            last_seq: Sequence number of the last record.
            by: Name of the writer.
            side: Its side.
            at: UTC wall time.

        Raises:
            IllegalTransition: A trigger the lifecycle does not allow from there, or not to this side.
            Fenced: A stale epoch.
            IllegalEvent: A goal or node event out of order, or from the wrong side.
            DefinitionError: A contract that is none.
        """
        sessions, goals = self._sessions, self._goals
        staged = Admission()
        staged._sessions = _Overlay(sessions)
        staged._goals = _Overlay(goals)
        records = []
        for index, (entry, text) in enumerate(zip(entries, markdown, strict=True)):
            source, to, epoch = staged._check(entry, side)
            record = Record(
                seq=last_seq + 1 + index,
                id=entry.id,
                ev=entry.ev,
                source=source,
                to=to,
                by=by,
                side=side.value,
                epoch=epoch,
                at=at,
                more=len(entries) - 1 - index,
                markdown=text,
            )
            staged.apply(record)
            records.append(record)
        return records

    def _check(self, entry: Entry, side: Side) -> tuple[str | None, str | None, int | None]:
        """State before, state after and epoch after, or an error."""
        if entry.id.startswith((GOAL_PREFIX, NODE_PREFIX)):
            self._check_goal(entry, side)
            return None, None, None
        state, epoch = self._sessions.get(entry.id, (_UNKNOWN, 0))
        if entry.ev == "submit":
            if state != _UNKNOWN:
                compute_next_state(entry.id, state, entry.ev, side)  # refuses, and says what would be possible
            if side is Side.RUNTIME or entry.id == JOURNAL_ID:
                raise IllegalTransition(entry.id, state, entry.ev, side, ("submit, by the agent or an operator",))
            _check_contract(entry)
            return None, SessionState.PENDING.value, 0
        if state == _UNKNOWN:
            raise IllegalTransition(entry.id, state, entry.ev, side, ("submit",))
        if side is Side.RUNTIME and entry.epoch is not None and entry.epoch != epoch:
            raise Fenced(entry.id, entry.ev, entry.epoch, epoch)
        return state, compute_next_state(entry.id, state, entry.ev, side), epoch + (entry.ev == "claim")

    def _check_goal(self, entry: Entry, side: Side) -> None:
        is_goal = entry.id.startswith(GOAL_PREFIX)
        possible = [event.value for event in (_OF_GOALS if is_goal else _OF_NODES)]
        if entry.ev not in possible:
            reason = f"no such event. Possible: {format_names(possible)}. {format_hint(entry.ev, possible)}"
            raise IllegalEvent(entry.id, entry.ev, reason.rstrip())
        if side is Side.RUNTIME or (side is Side.OPERATOR and entry.ev not in _BY_OPERATOR):
            raise IllegalEvent(entry.id, entry.ev, f"the {side} may not say this; goals and nodes belong to the agent")
        goal = entry.id.partition(":")[2] if is_goal else split_node_id(entry.id)[0]
        latest = self._goals.get(goal)
        if (latest is None) != (entry.ev == GoalEvent.GOAL_SUBMITTED):
            said = "it was submitted before" if latest else "nobody has submitted this goal"
            raise IllegalEvent(entry.id, entry.ev, said)
        if latest == GoalEvent.GOAL_VERDICT:
            raise IllegalEvent(entry.id, entry.ev, "the goal has its verdict, which is final")


class _Overlay(dict[str, Any]):
    """A mapping that reads through to another one and keeps what is written to itself."""

    def __init__(self, below: dict[str, Any]) -> None:
        super().__init__()
        self._below = below

    def get(self, key: str, default: Any = None) -> Any:
        """The staged value, else the one below."""
        return super().get(key) if key in self else self._below.get(key, default)


def split_node_id(id: str) -> tuple[str, str]:
    """Goal id and node of `node:<goal id>/<node>`.

    Raises:
        IllegalEvent: When it has no such form.
    """
    goal, slash, node = id.removeprefix(NODE_PREFIX).partition("/")
    if not (goal and slash and node):
        raise IllegalEvent(id, "", "expected 'node:<goal id>/<node>'")
    return goal, node


def _check_contract(entry: Entry) -> None:
    try:
        session = msgspec.convert(entry.body, Session)
    except msgspec.ValidationError as error:
        raise DefinitionError(
            Problem(
                code="INVALID_CONTRACT",
                address=f"session {entry.id}",
                found=str(error),
                expected="a Session as a mapping (msgspec.to_builtins)",
            )
        ) from error
    if session.id != entry.id:
        raise DefinitionError(
            Problem(code="NAME_MISMATCH", address=f"session {entry.id}", found=session.id, expected=entry.id)
        )
