"""5. A scorer: what an episode of a suite achieved, whatever its verdict. Run me: python examples/05_scorer.py"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phyagentos.bench.scorers.scorer import Scorer


def check(located: Any, address: Any, condition: Any) -> list[Any]:
    is_number = isinstance(condition, int | float) and condition > 0
    return [] if is_number else [located.problem("INVALID_VALUE", address, repr(condition), "seconds above 0")]


def score(parts: Mapping[str, Any], workspace: Path, bundle: Path | None) -> dict[str, bool] | None:
    """Whether all that moved the robot, or one session of it, took less time than each part allows."""
    found = [bundle] if bundle is not None else sorted((workspace / "evidence").iterdir())
    times_s = [np.load(each / "trajectory.npz")["time_s"] for each in found if (each / "trajectory.npz").is_file()]
    spent_s = sum(float(each[-1] - each[0]) for each in times_s if len(each))
    return {part: spent_s <= limit_s for part, limit_s in parts.items()} if times_s else None


QUICK = Scorer(name="quick", check=check, score=score)

if __name__ == "__main__":
    from phyagentos.testing import SkillStand, make_contract

    stand = SkillStand()
    stand.add_tree("{tree: rest, description: Wait a second., root: {wait: {seconds: 1.0}}}")
    stand.run(make_contract(skill="rest"))
    print(QUICK.score({"two seconds": 2.0, "half a second": 0.5}, stand.workspace, None))
