"""How long verdicts wait for people: for the answers to questions of sessions and of the goal, where any is asked."""

from collections.abc import Iterable
from dataclasses import dataclass

from phyagentos.clock import Clock, compute_seconds
from phyagentos.protocol.sessions.answers import find_open
from phyagentos.protocol.sessions.session import Ended, SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace


@dataclass(frozen=True, slots=True)
class Patience:
    """Waits as long as a goal says, from the end of the session that is asked about."""

    workspace: Workspace
    clock: Clock

    def waits_for_session(self, status: SessionStatus, longest_s: float) -> bool:
        """Whether its verdict waits; one whose instructions did not run to their end is asked nothing about."""
        is_whole = status.execution is not None and status.execution.ended is Ended.COMPLETED
        folder = self.workspace.evidence_of(status.contract.id)
        is_open = is_whole and bool(find_open(folder, status.contract.accept))
        return is_open and self._is_left(status.updated_at, longest_s)

    def waits_for_goal(self, goal: GoalStatus, accept: Iterable[str], since: str, longest_s: float) -> bool:
        """Whether its verdict waits, since the end of its last session."""
        is_open = bool(find_open(self.workspace.answers_of(goal.id), accept))
        return is_open and bool(since) and self._is_left(since, longest_s)

    def _is_left(self, since: str, longest_s: float) -> bool:
        return compute_seconds(since, self.clock.wall_iso()) < longest_s
