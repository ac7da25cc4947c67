"""One run that was attacked, and what came of it: shared by the scripts that kill, cut and stop."""

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True, kw_only=True)
class Attacked:
    """What was done to whom, and what came of it; `delay_s` is the time until then, `wall_s` the whole run's [s]."""

    number: int
    victim: str
    attack: str
    delay_s: float
    verdict: str = ""
    causes: list[str] = field(default_factory=list)
    problems: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    wall_s: float = 0.0

    def blame(self, what: str, note: str) -> None:
        """Count one broken promise."""
        self.problems[what] += 1
        self.notes.append(f"{what}: {note}")
