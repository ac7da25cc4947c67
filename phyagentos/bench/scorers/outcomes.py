"""The scorer `outcomes`: what an environment's own predicate wrote down, in a process that the agent never reads from.

A condition is the name of an outcome; each line of `.world/outcomes.jsonl` is an episode of the environment, the last
one counts: `{"success": true, "steps": 80}`, or lists of what was completed: `{"completed": ["microwave"]}`.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from phyagentos.bench.scorers.scorer import Scorer
from phyagentos.errors import Problem
from phyagentos.protocol.documents.schema import Address, Located

FILE = Path(".world") / "outcomes.jsonl"  # below a workspace


def _check(located: Located, path: Address, condition: Any) -> list[Problem]:
    if isinstance(condition, str) and condition:
        return []
    return [located.problem("INVALID_VALUE", path, repr(condition), "the name of an outcome, such as success")]


def _score(parts: Mapping[str, Any], workspace: Path, bundle: Path | None) -> dict[str, bool] | None:
    if bundle is not None:
        return None  # an environment says what became of the episode, not after which session
    lines = (workspace / FILE).read_text().splitlines() if (workspace / FILE).is_file() else []
    last = json.loads(lines[-1]) if lines else {}
    return {part: bool(last.get(name)) or name in last.get("completed", ()) for part, name in parts.items()}


OUTCOMES = Scorer(name="outcomes", check=_check, score=_score)
