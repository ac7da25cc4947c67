"""Which records may be added: the lifecycle of sessions, fencing by epoch, and which side may write about goals.

The writer calls it with the partition locked: check and write are one step (compare-and-set). It holds three facts per
session, and forgets what is final once it can be looked up.
"""

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from typing import TypeVar

import msgspec

from phyagentos.errors import DefinitionError, PhyAgentOSError, format_hint, format_names
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.lifecycle import (
    FINAL_STATES,
    REVIEW,
    IllegalTransition,
    SessionEvent,
    SessionState,
    Side,
    fire,
)
from phyagentos.protocol.sessions.session import Amendment, Limits, Session
from phyagentos.store.records import JOURNAL_ID, Record

GOAL_PREFIX = "goal:"
NODE_PREFIX = "node:"
_StructT = TypeVar("_StructT", bound=msgspec.Struct)
_OF_AGENT = (GOAL_PREFIX, NODE_PREFIX)
_UNKNOWN = "unknown"  # state of a session that was never submitted


class GoalEvent(StrEnum):
    """Events of a goal (`goal:<goal id>`) or one of its nodes (`node:<goal id>/<node>`)."""

    GOAL_SUBMITTED = "goal_submitted"
    """A person asked for it; the first record of every goal."""
    GOAL_COMPILED = "goal_compiled"
    """Its graph is known."""
    AMENDMENT_ASKED = "amendment_asked"
    """A person wants another graph for it."""
    GOAL_AMENDED = "goal_amended"
    """Its graph has changed: what was still open became other nodes."""
    AMENDMENT_REFUSED = "amendment_refused"
    """The wanted graph contradicts what has begun."""
    NODE_READY = "node_ready"
    """Everything the node waits for is done."""
    CHILD_OF = "child_of"
    """A child session continues the node."""
    NODE_DONE = "node_done"
    """A session of the node succeeded."""
    NODE_BLOCKED = "node_blocked"
    """The node cannot be done."""
    NODE_SKIPPED = "node_skipped"
    """The branch of the node is not taken."""
    NODE_RESCUED = "node_rescued"
    """The branch on the failure of the node succeeded."""
    INVALIDATED = "invalidated"
    """What the node achieved no longer holds."""
    NODE_WAITS = "node_waits"
    """The next session of the node needs what other nodes must achieve again."""
    BUDGET_SPENT = "budget_spent"
    """A replan was paid for."""
    GOAL_VERDICT = "goal_verdict"
    """Whether the goal was met; the last record of every goal."""
    GOAL_CANCELLED = "goal_cancelled"
    """An end was requested."""


_AGENT, _RUNTIME = Side.AGENT, Side.RUNTIME  # an enumeration takes its time to find a member
_PENDING = SessionState.PENDING.value
_SUBMITTED, _VERDICT = GoalEvent.GOAL_SUBMITTED.value, GoalEvent.GOAL_VERDICT.value
_OF_BOTH = frozenset({GoalEvent.BUDGET_SPENT.value})
_BY_OPERATOR = frozenset({_SUBMITTED, GoalEvent.GOAL_CANCELLED.value, GoalEvent.AMENDMENT_ASKED.value})
_CHANGES = {each.value for each in (GoalEvent.GOAL_COMPILED, GoalEvent.GOAL_AMENDED, GoalEvent.AMENDMENT_REFUSED)}
_OF_GOALS = _BY_OPERATOR | _OF_BOTH | _CHANGES | {_VERDICT}
_OF_NODES = frozenset(event.value for event in GoalEvent) - _OF_GOALS | _OF_BOTH
_FORGETTABLE = frozenset({*FINAL_STATES, GoalEvent.GOAL_VERDICT})


class Entry(msgspec.Struct, frozen=True):
    """What is to be recorded.

    Attributes:
        id: A session id, `goal:<goal id>` or `node:<goal id>/<node>`.
        ev: `submit`, a trigger of the lifecycle, or a `GoalEvent`.
        body: The contract for `submit`; an `Amendment` for `amend`; `execution` for `finish`; `attempt` for `accept`,
            `refuse`, `replan`, `skip`, `review`; `reason` for `reject`, `cancel`, `lose`; for goals see `ledger`.
        epoch: The fencing token the caller acts under; None where there is none. With `claim`: the epoch it saw.
    """

    id: str
    ev: str
    body: Fields | None = None
    epoch: int | None = None


class IllegalEvent(PhyAgentOSError):
    """A goal or node event that cannot be recorded."""

    def __init__(self, id: str, event: str, reason: str) -> None:
        self.id, self.event, self.reason = id, event, reason
        super().__init__(f"{id}: {event!r} refused: {reason}")


class Known(msgspec.Struct, frozen=True, gc=False):
    """What is remembered of a session or goal: its state (of a goal, the latest event that matters here)."""

    state: str
    epoch: int
    seq: int


class Admission:
    """Judges entries against everything recorded so far.

    Args:
        recall: Finds a session or goal (`goal:<goal id>`) that was forgotten, None when it never was.
        is_past: Whether the records were admitted already, and are only checked: by the rows of their day.
    """

    def __init__(self, recall: Callable[[str], Known | None] = lambda _: None, *, is_past: bool = False) -> None:
        self._is_past = is_past
        self._known: dict[str, Known] = {}
        self._staged: dict[str, Known] = {}
        self._recall = recall

    def apply(self, record: Record) -> None:
        """Take note of a record."""
        known = read_known(record)
        if known is not None:
            self._known[record.id] = known

    def restore(self, known: Mapping[str, Known]) -> None:
        """Add facts of a checkpoint or an older record; what is known already stands."""
        self._known = {**known, **self._known}

    def knows(self, id: str) -> bool:
        """Whether a session or goal of this id was ever submitted."""
        return self._find(id) is not None

    def forget(self, last_seq: int) -> list[str]:
        """Let go of what is final and can be recalled: all whose latest record is `last_seq` or an earlier one."""
        over = [id for id, known in self._known.items() if known.seq <= last_seq and known.state in _FORGETTABLE]
        for id in over:
            del self._known[id]
        return over

    def admit(
        self, entries: Sequence[Entry], markdown: Sequence[str], *, last_seq: int, by: str, side: Side, at: str
    ) -> list[Record]:
        """The records these entries become, each checked as if those before it were recorded.

        Raises:
            IllegalTransition: A trigger the lifecycle does not allow from there, or not to this side.
            Fenced: A stale epoch.
            IllegalEvent: A goal or node event out of order, or from the wrong side.
            DefinitionError: An invalid contract.
        """
        self._staged = {}
        records = []
        seq, more = last_seq, len(entries)
        side_name = side.value
        for entry, text in zip(entries, markdown, strict=True):
            seq, more = seq + 1, more - 1
            contract: Session | None = None
            source: str | None = None
            to: str | None = None
            epoch: int | None = None
            if entry.id.startswith(_OF_AGENT):
                self._check_goal(entry, side)
            elif entry.ev == "submit":
                contract = self._check_submit(entry, side)
                to, epoch = _PENDING, 0
            else:
                source, to, epoch = self._check(entry, side)
            record = Record(
                seq=seq,
                id=entry.id,
                ev=entry.ev,
                source=source,
                to=to,
                by=by,
                side=side_name,
                epoch=epoch,
                at=at,
                more=more,
                markdown=text,
            )
            record.remember(entry.body or None, contract)
            if more:
                known = read_known(record)
                if known is not None:
                    self._staged[record.id] = known
            records.append(record)
        return records

    def _find(self, id: str) -> Known | None:
        """What is known, those before it in the batch included."""
        known = self._staged.get(id) or self._known.get(id)
        if known is None and (known := self._recall(id)) is not None:
            self._known[id] = known
        return known

    def _check_submit(self, entry: Entry, side: Side) -> Session:
        known = self._find(entry.id)
        if known is not None:
            self._fire(entry, known, side)  # refuses, with what would be possible
        if side is _RUNTIME or entry.id == JOURNAL_ID:
            state = known.state if known else _UNKNOWN
            raise IllegalTransition(entry.id, state, entry.ev, side, ("submit, by the agent or an operator",))
        return self._check_contract(entry, side)

    def _check(self, entry: Entry, side: Side) -> tuple[str, str, int]:
        """State before, state after and epoch after, or an error."""
        known = self._find(entry.id)
        if known is None:
            raise IllegalTransition(entry.id, _UNKNOWN, entry.ev, side, ("submit",))
        fired = self._fire(entry, known, side)
        if entry.ev == "amend":
            _check_amendment(entry)
        elif entry.ev == REVIEW:
            _check_review(entry)
        return known.state, fired.state, fired.epoch

    def _fire(self, entry: Entry, known: Known, side: Side) -> SessionEvent:
        return fire(
            SessionEvent(
                session_id=entry.id,
                state=known.state,
                epoch=known.epoch,
                trigger=entry.ev,
                side=side.value,
                token=entry.epoch,
                is_past=self._is_past,
            )
        )

    def _check_contract(self, entry: Entry, side: Side) -> Session:
        session = _convert(entry, Session)
        if session.id != entry.id:
            raise DefinitionError.of("INVALID_VALUE", f"session {entry.id}", session.id, entry.id)
        if side is Side.OPERATOR and self._find(GOAL_PREFIX + session.goal) is not None:
            raise IllegalEvent(entry.id, entry.ev, f"the sessions of goal {session.goal!r} belong to the agent")
        return session

    def _check_goal(self, entry: Entry, side: Side) -> None:
        is_goal = entry.id.startswith(GOAL_PREFIX)
        possible = _OF_GOALS if is_goal else _OF_NODES
        if entry.ev not in possible:
            reason = f"no such event. Possible: {format_names(possible)}. {format_hint(entry.ev, possible)}"
            raise IllegalEvent(entry.id, entry.ev, reason.rstrip())
        if side is not _AGENT and (side is _RUNTIME or entry.ev not in _BY_OPERATOR):
            raise IllegalEvent(
                entry.id, entry.ev, f"the {side} may not record this; goals and nodes belong to the agent"
            )
        goal = entry.id if is_goal else GOAL_PREFIX + split_node_id(entry.id)[0]
        known = self._find(goal)
        if (known is None) != (entry.ev == _SUBMITTED):
            why = "it was submitted before" if known else "this goal was never submitted"
            raise IllegalEvent(entry.id, entry.ev, why)
        if known is not None and known.state == _VERDICT:
            raise IllegalEvent(entry.id, entry.ev, "the goal has its verdict, which is final")


def read_known(record: Record) -> Known | None:
    """What a record makes known of a session or goal; None when nothing that matters here."""
    if record.to is not None:
        return Known(record.to, record.epoch or 0, record.seq)
    if record.id.startswith(GOAL_PREFIX) and record.ev in _OF_GOALS:
        return Known(record.ev, 0, record.seq)
    return None


def split_node_id(id: str) -> tuple[str, str]:
    """Goal id and node of `node:<goal id>/<node>`; anything else raises IllegalEvent."""
    goal, slash, node = id.removeprefix(NODE_PREFIX).partition("/")
    if not (goal and slash and node):
        raise IllegalEvent(id, "", "expected 'node:<goal id>/<node>'")
    return goal, node


def _convert(entry: Entry, kind: type[_StructT]) -> _StructT:
    try:
        return msgspec.convert(entry.body or {}, kind)
    except msgspec.ValidationError as error:
        raise DefinitionError.of(
            "INVALID_VALUE", f"session {entry.id}", str(error), f"{kind.__name__} as a mapping (msgspec.to_builtins)"
        ) from error


def _check_review(entry: Entry) -> None:
    """A judgement that is added later must be marked, or it would be taken for the one that decided."""
    attempt = (entry.body or {}).get("attempt")
    is_review = attempt.get("is_review") if isinstance(attempt, dict) else getattr(attempt, "is_review", False)
    if not is_review:
        found = "no attempt with is_review"
        expected = "a judgement marked as added after the verdict"
        raise DefinitionError.of("INVALID_VALUE", f"session {entry.id}: {REVIEW}", found, expected)


def _check_amendment(entry: Entry) -> None:
    for name in _convert(entry, Amendment).limits:
        if name not in Limits.__struct_fields__:
            raise DefinitionError.unknown("limit", f"session {entry.id}: limits", name, Limits.__struct_fields__)
