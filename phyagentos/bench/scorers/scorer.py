"""The port of scorers, and the scorers `outcomes` and `verdict`.

A scorer says what an episode achieved, whatever its verdict: from the recorded state of the simulator, or, `outcomes`,
from what an environment's own predicate wrote down, in a process that the agent never reads from. Its condition is the
name of an outcome; `.world/outcomes.jsonl` has a line a session; the last one counts, or that of the session asked
about: `{"session": "goal.node", "success": true, "completed": ["microwave"]}`. `verdict` alone asks no
other: a goal is met where its verdict is the condition, and so no false success is found.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phyagentos.assembly.paths import OUTCOMES as FILE
from phyagentos.errors import Problem
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Address, Located


@dataclass(frozen=True, slots=True, kw_only=True)
class Scorer:
    """One scorer.

    Attributes:
        name: By which a suite asks for it.
        check: Problems of one condition, which stands at a place of the suite; nothing has run.
        score: Which conditions hold: given part -> condition, the workspace, whose processes have ended, and the bundle
            of the session after which it is asked, or None at the end of the episode. None where it cannot be said.
        list_bodies: The bodies of a scene that a sound condition names.
    """

    name: str
    check: Callable[[Located, Address, Any], list[Problem]]
    score: Callable[[Fields, Path, Path | None], dict[str, bool] | None]
    list_bodies: Callable[[Any], tuple[str, ...]] = lambda condition: ()


def _check(located: Located, path: Address, condition: Any) -> list[Problem]:
    if isinstance(condition, str) and condition:
        return []
    return [located.problem("INVALID_VALUE", path, repr(condition), "the name of an outcome, such as success")]


def _score(parts: Fields, workspace: Path, bundle: Path | None) -> dict[str, bool] | None:
    lines = (workspace / FILE).read_text(encoding="utf-8").splitlines() if (workspace / FILE).is_file() else []
    found = [each for each in map(json.loads, lines) if bundle is None or each.get("session") == bundle.name]
    last = found[-1] if found else {}
    return {part: bool(last.get(name)) or name in last.get("completed", ()) for part, name in parts.items()}


OUTCOMES = Scorer(name="outcomes", check=_check, score=_score)


def _read_verdicts(parts: Mapping[str, object], workspace: Path, _: Path | None) -> dict[str, bool]:
    goals = read_ledger(workspace).goals.values()
    return {part: any(goal.verdict == wanted for goal in goals) for part, wanted in parts.items()}


VERDICT = Scorer(name="verdict", check=_check, score=_read_verdicts)
