"""How long verdicts wait for people: for answers to the questions of sessions and of the goal."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from phyagentos.clock import Clock, compute_seconds
from phyagentos.protocol.sessions.answers import find_open


@dataclass(frozen=True, slots=True)
class Patience:
    """Waits as long as a goal says, from the end of the session in question."""

    clock: Clock

    def waits(self, folder: Path, accept: Iterable[str], since: str, longest_s: float) -> bool:
        """Whether a question among criteria has no answer in a folder, and there is time for one."""
        is_open = bool(since) and bool(find_open(folder, accept))
        return is_open and compute_seconds(since, self.clock.wall_iso()) < longest_s
