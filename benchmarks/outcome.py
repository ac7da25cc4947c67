"""The one JSON line that a benchmark ends with."""

import json
from collections.abc import Mapping

from phyagentos.bench.report import Ask


def format_outcome(figures: Mapping[str, float], asked: Mapping[str, Ask]) -> tuple[str, bool]:
    """The closing JSON line of a benchmark, and whether every asked figure holds."""
    holds = all(ask.holds(figures[name]) for name, ask in asked.items())
    line = json.dumps(
        {
            "figures": {name: round(value, 6) for name, value in figures.items()},
            "asked": {name: str(ask) for name, ask in asked.items()},
            "holds": holds,
        }
    )
    return line, holds
