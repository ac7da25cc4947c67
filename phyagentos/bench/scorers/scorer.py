"""The port of scorers.

A scorer says what an episode achieved, whatever its verdict: from the recorded state of the simulator, or from what an
environment's own predicate wrote down.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phyagentos.errors import Problem
from phyagentos.protocol.documents.schema import Address, Located


@dataclass(frozen=True, slots=True, kw_only=True)
class Scorer:
    """One scorer.

    Attributes:
        name: By which a suite asks for it.
        check: Problems of one condition, which stands at a place of the suite; nothing has run.
        score: Which conditions hold: given part -> condition, the workspace, whose processes have ended, and the bundle
            of the session after which it is asked, or None at the end of the episode. None where it cannot be said.
    """

    name: str
    check: Callable[[Located, Address, Any], list[Problem]]
    score: Callable[[Mapping[str, Any], Path, Path | None], dict[str, bool] | None]
