"""The scorer `outcomes`: what an environment's own predicate wrote down, in a process that the agent never reads from.

A condition is the name of an outcome; `.world/outcomes.jsonl` has a line a session; the last one counts, or that of the
session asked about: `{"session": "goal.node", "success": true, "completed": ["microwave"]}`.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from phyagentos.assembly.paths import OUTCOMES as FILE
from phyagentos.bench.scorers.scorer import Scorer
from phyagentos.errors import Problem
from phyagentos.protocol.documents.schema import Address, Located


def _check(located: Located, path: Address, condition: Any) -> list[Problem]:
    if isinstance(condition, str) and condition:
        return []
    return [located.problem("INVALID_VALUE", path, repr(condition), "the name of an outcome, such as success")]


def _score(parts: Mapping[str, Any], workspace: Path, bundle: Path | None) -> dict[str, bool] | None:
    lines = (workspace / FILE).read_text().splitlines() if (workspace / FILE).is_file() else []
    found = [each for each in map(json.loads, lines) if bundle is None or each.get("session") == bundle.name]
    last = found[-1] if found else {}
    return {part: bool(last.get(name)) or name in last.get("completed", ()) for part, name in parts.items()}


OUTCOMES = Scorer(name="outcomes", check=_check, score=_score)
