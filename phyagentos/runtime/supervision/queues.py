"""Queues of waiting sessions by target, and the resources that targets share.

Priorities age by `ageing_per_s`. All waiting sessions gain alike, so their order never changes and each has one key
for good: a claim costs O(log n). None starves: one that comes later by more than the difference of the priorities,
divided by the rate, comes after.

Resources are granted all at once or not at all, the senior session first. What a senior session waits for is granted
to no junior one: no deadlock, and no session that two others keep out in turn. What stands behind the head of a
target's queue never overtakes it.
"""

import heapq
import itertools
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

from phyagentos.clock import Clock
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.session import Session, SessionId, SessionStatus
from phyagentos.store.ledger import Ledger

RESOURCE_UNAVAILABLE = "RESOURCE_UNAVAILABLE"
AGEING_PER_S = 1.0 / 60.0  # see `RuntimeContract.ageing_per_min`
SLACK = 1000  # so many deadlines of sessions that no longer wait may be remembered before they are swept


class _Ticket(NamedTuple):
    """Wall time since which a session waits, never before an older one's [s]; its number; time by this clock [s]."""

    since_s: float
    number: int
    put_s: float


class _Waiter(NamedTuple):
    """One entry of a queue, least first; outdated once the session has another priority."""

    key: float
    number: int
    id: SessionId
    priority: int


@dataclass(frozen=True, slots=True)
class Turn:
    """A session that has left its queue and, unless refused, holds its resources."""

    session: Session
    refused: Problem | None = None


class Queues:
    """All waiting sessions of one workspace; those that are no longer pending in the ledger are passed over.

    A waiting session gains priority, `ageing_per_s` [1/s].
    """

    def __init__(self, ledger: Ledger, clock: Clock, ageing_per_s: float = AGEING_PER_S) -> None:
        self._ledger = ledger
        self._clock = clock
        self._ageing_per_s = ageing_per_s
        self._heaps: dict[str, list[_Waiter]] = {}
        self._tickets: dict[SessionId, _Ticket] = {}  # of all that wait
        self._taken: dict[str, tuple[SessionId, _Ticket]] = {}  # by target, for one that is put back
        self._numbers = itertools.count()
        self._latest_s = -float("inf")
        self._deadlines: list[tuple[float, SessionId]] = []
        self._holders: dict[str, str] = {}  # resource -> target
        self._forsaken: dict[str, str] = {}  # resource -> target that will never let go of it

    def put(self, status: SessionStatus) -> None:
        """Add a session. It keeps its age when it is amended, or put back after its target was lost."""
        session = status.contract
        taken = self._taken.get(session.target)
        known = taken[1] if taken is not None and taken[0] == session.id else self._tickets.get(session.id)
        self._tickets[session.id] = ticket = known or self._make_ticket(status)
        key = self._ageing_per_s * ticket.since_s - session.priority
        waiter = _Waiter(key, ticket.number, session.id, session.priority)
        heapq.heappush(self._heaps.setdefault(session.target, []), waiter)
        heapq.heappush(self._deadlines, (ticket.put_s + session.limits.queue_s, session.id))
        if len(self._deadlines) > 2 * len(self._tickets) + SLACK:
            self._deadlines = [each for each in self._deadlines if each[1] in self._tickets]
            heapq.heapify(self._deadlines)

    def _make_ticket(self, status: SessionStatus) -> _Ticket:
        """A clock that was set back makes no later session older than an earlier one."""
        self._latest_s = max(self._latest_s, datetime.fromisoformat(status.updated_at).timestamp())
        return _Ticket(self._latest_s, next(self._numbers), self._clock.now_s())

    def iter_targets(self) -> Iterator[str]:
        """Targets for which a session may wait."""
        return (target for target, heap in self._heaps.items() if heap)

    def has_waiting(self, target: str) -> bool:
        """Whether a session waits for a target."""
        return self._find_head(target) is not None

    def take(self, target: str) -> Session | None:
        """The next session of a target, whatever it needs."""
        session = self._find_head(target)
        if session is not None:
            self._remove(session)
        return session

    def grant(self, idle: Collection[str], starting: Collection[str] = ()) -> list[Turn]:
        """The sessions whose turn it is on idle targets; at most one for each.

        What the next session of a `starting` target needs is kept from junior ones: whose worker is ready first decides
        nothing.
        """
        heads = [session for target in idle if (session := self._find_head(target)) is not None]
        turns = [Turn(session) for session in heads if not session.resources]
        soon = [session for target in starting if (session := self._find_head(target)) is not None]
        needy = (session for session in (*heads, *soon) if session.resources)
        turns += self._share(sorted(needy, key=lambda each: self._heaps[each.target][0]), starting)
        for turn in turns:
            self._remove(turn.session)
        return turns

    def hold(self, target: str, resources: Collection[str]) -> None:
        """Note resources that a target may be using already."""
        self._holders.update(dict.fromkeys(resources, target))

    def release(self, target: str) -> None:
        """Free the resources of a target that is at rest and observed."""
        self._holders = {name: holder for name, holder in self._holders.items() if holder != target}

    def forsake(self, target: str) -> None:
        """Keep the resources of a target that is given up unobserved; they are granted to no other."""
        self._forsaken |= {name: holder for name, holder in self._holders.items() if holder == target}

    def pop_overdue(self) -> Iterator[Session]:
        """Take out sessions that have waited longer than their contracts allow."""
        now_s = self._clock.now_s()
        while self._deadlines and self._deadlines[0][0] <= now_s:
            _, id = heapq.heappop(self._deadlines)
            ticket, status = self._tickets.get(id), self._ledger.sessions.get(id)
            if ticket is None or status is None or status.state != SessionState.PENDING:
                continue
            deadline_s = ticket.put_s + status.contract.limits.queue_s
            if deadline_s > now_s:  # amended
                heapq.heappush(self._deadlines, (deadline_s, id))
                continue
            del self._tickets[id]
            yield status.contract

    def _find_head(self, target: str) -> Session | None:
        heap = self._heaps.get(target, [])
        while heap:
            head = heap[0]
            status = self._ledger.sessions.get(head.id)
            if status is not None and status.state == SessionState.PENDING and head.id in self._tickets:
                if status.contract.priority == head.priority:
                    return status.contract
            else:
                self._tickets.pop(head.id, None)
            heapq.heappop(heap)
        return None

    def _remove(self, session: Session) -> None:
        heapq.heappop(self._heaps[session.target])
        self._taken[session.target] = session.id, self._tickets.pop(session.id)

    def _share(self, needy: list[Session], starting: Collection[str]) -> Iterator[Turn]:
        """Grant free resources by seniority; what a senior session waits for is kept from junior ones."""
        promised: set[str] = set()
        for session in needy:
            lost = next((name for name in session.resources if name in self._forsaken), None)
            if session.target in starting:
                promised.update(session.resources)
            elif lost is not None:
                why = f"{lost!r} is held by {self._forsaken[lost]!r}, which is broken"
                yield Turn(session, Problem(RESOURCE_UNAVAILABLE, f"{session.id}: resources", why))
            elif promised.isdisjoint(session.resources) and self._holders.keys().isdisjoint(session.resources):
                self.hold(session.target, session.resources)
                yield Turn(session)
            else:
                promised.update(session.resources)
