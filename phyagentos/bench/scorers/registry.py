"""The scorers by name. A plug-in is a `Scorer` in the entry point group `phyagentos.scorers`."""

from importlib.metadata import entry_points

from phyagentos.bench.scorers.outcomes import OUTCOMES
from phyagentos.bench.scorers.scorer import Scorer
from phyagentos.bench.scorers.simulator import SIMULATOR

ENTRY_POINT_GROUP = "phyagentos.scorers"


def build_scorer_registry() -> dict[str, Scorer]:
    """What ships, and what installed packages announce; raises ValueError for a name that is taken."""
    scorers = {each.name: each for each in (OUTCOMES, SIMULATOR)}
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
        if point.name in scorers:
            raise ValueError(f"scorer {point.name!r} is registered already")
        scorers[point.name] = point.load()
    return scorers
