"""Motion requests in flight: keeps thinking out of simulated time.

Requests go to the planner one after the other, in the order in which they were submitted. The tree is not ticked while
an answer is outstanding, so the number of ticks, and with it every trajectory, does not depend on how fast this machine
plans.
"""

from collections import deque
from typing import TYPE_CHECKING

from phyagentos.runtime.motion.requests import MotionAnswer, MotionRequest

if TYPE_CHECKING:
    from phyagentos.runtime.motion.process import Planner


class Thinker:
    """A queue in front of a planner.

    Args:
        planner: Works on one request at a time.
    """

    def __init__(self, planner: "Planner") -> None:
        self._planner = planner
        self._waiting: deque[tuple[int, MotionRequest]] = deque()
        self._current: int | None = None
        self._answers: dict[int, MotionAnswer] = {}
        self._unwanted: set[int] = set()
        self._count = 0

    def submit(self, request: MotionRequest) -> int:
        """Queue a request; returns its ticket."""
        self._count += 1
        self._waiting.append((self._count, request))
        self._advance()
        return self._count

    def take(self, ticket: int) -> MotionAnswer | None:
        """The answer to a ticket, once; None while it is outstanding."""
        self._advance()
        return self._answers.pop(ticket, None)

    def is_thinking(self) -> bool:
        """Whether any answer is outstanding."""
        self._advance()
        return self._current is not None

    def wait(self, timeout_s: float) -> None:
        """Sleep until the planner answers, at most `timeout_s` [s] by the wall."""
        self._planner.wait(timeout_s)

    def drop(self, ticket: int) -> None:
        """The answer is not wanted any more."""
        self._answers.pop(ticket, None)
        self._waiting = deque(item for item in self._waiting if item[0] != ticket)
        if ticket == self._current:
            self._abandon(ticket)

    def drop_all(self) -> None:
        """Cancel everything."""
        self._waiting.clear()
        self._answers.clear()
        if self._current is not None:
            self._abandon(self._current)

    def _abandon(self, ticket: int) -> None:
        if ticket not in self._unwanted:
            self._unwanted.add(ticket)
            self._planner.cancel()

    def _advance(self) -> None:
        if self._current is not None:
            answer = self._planner.poll()
            if answer is None:
                return
            if self._current in self._unwanted:
                self._unwanted.discard(self._current)
            else:
                self._answers[self._current] = answer
            self._current = None
        if self._waiting:
            self._current, request = self._waiting.popleft()
            self._planner.submit(request)
