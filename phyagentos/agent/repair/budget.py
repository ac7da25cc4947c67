"""Remaining sessions and simulated time of a goal, counted from its records."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from phyagentos.agent.goals.spec import Budget
from phyagentos.protocol.sessions.session import SessionStatus

BUDGET = "BUDGET"


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """Remainder of a budget: sessions, simulated time of all together [s]; `needed` are those of nodes without one."""

    sessions: float = math.inf
    sim_time_s: float = math.inf
    needed: int = 0

    def find_excess(self, sessions: int, sim_time_s: float) -> str:
        """Why such a cost exceeds the budget, empty when it does not."""
        if sessions + self.needed > self.sessions:
            asked = f"{sessions} more and {self.needed} for nodes not yet begun"
            return f"{BUDGET}: {self.sessions:g} sessions are left, it takes {asked}"
        if sim_time_s > self.sim_time_s:
            return f"{BUDGET}: {self.sim_time_s:.1f} s are left, it takes {sim_time_s:.1f} s"
        return ""

    def find_end(self) -> str:
        """Why no further session may begin, empty when one may."""
        if self.sessions < 1:
            return f"{BUDGET}: every session of the goal's budget is spent"
        if self.sim_time_s <= 0.0:
            return f"{BUDGET}: the simulated time of the goal's budget is spent, or granted to sessions that run"
        return ""


def compute_left(budget: Budget, sessions: Iterable[SessionStatus], needed: int = 0) -> Left:
    """Remainder after these sessions."""
    count, spent_s = 0, 0.0
    for status in sessions:
        count += 1
        spent_s += status.execution.sim_time_s if status.execution else 0.0
    return Left(
        sessions=math.inf if budget.sessions is None else budget.sessions - count,
        sim_time_s=math.inf if budget.sim_time_s is None else budget.sim_time_s - spent_s,
        needed=needed,
    )
