"""Remedies for a failed rehearsal, by its most frequent cause, in the terms of a contract's `strategy`.

The search is greedy: the next strategy is a remedy for the best one so far.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from phyagentos.protocol.sessions.strategy import Strategy

SLOWER = 0.5  # at half the speed inertia is a quarter
SLOWEST = 0.125  # a session that creeps meets its time limit instead


class Tried(NamedTuple):
    """A strategy that was rehearsed.

    Attributes:
        share: Of its rollouts, that met the contract, 0..1.
    """

    strategy: Strategy
    share: float
    cause: str
    grasp: str
    site: str


def propose(tried: Sequence[Tried]) -> Strategy | None:
    """The next strategy worth a rehearsal; None when nothing is left to try."""
    known = {each.strategy for each in tried}
    for each in sorted(tried, key=lambda each: -each.share):
        for remedy in _REMEDIES.get(each.cause, ()):
            strategy = remedy(each)
            if strategy not in known:
                return strategy
    return None


def _go_slower(tried: Tried) -> Strategy:
    return tried.strategy.slow_down(SLOWER, SLOWEST)


def _grasp_otherwise(tried: Tried) -> Strategy:
    return tried.strategy.avoid(grasp=tried.grasp)


def _arrive_otherwise(tried: Tried) -> Strategy:
    """The same place from another side."""
    return tried.strategy.avoid(site=tried.site)


def _place_elsewhere(tried: Tried) -> Strategy:
    """Another place: a label is `<site>.<yaw>`."""
    return tried.strategy.avoid(site=tried.site.partition(".")[0])


_Remedies = tuple[Callable[[Tried], Strategy], ...]
_UNPLANNED: _Remedies = (_grasp_otherwise, _place_elsewhere, lambda tried: tried.strategy.avoid_nothing())
_REMEDIES: Mapping[str, _Remedies] = {
    "GRASP_MISSED": (_grasp_otherwise,),
    "GRASP_LOST": (_go_slower, _grasp_otherwise),
    "LOAD_LOST": (_go_slower, _grasp_otherwise, _place_elsewhere),
    "PLACED_WRONG": (_place_elsewhere, _go_slower, _grasp_otherwise),
    "OBJECT_MOVED": (_arrive_otherwise, _place_elsewhere, _grasp_otherwise, _go_slower),
    "WITHOUT_EFFECT": (_grasp_otherwise,),
    "CONSTRAINT_VIOLATED": (_go_slower, _place_elsewhere, _grasp_otherwise),
    "HOLD_VIOLATED": (_go_slower, _place_elsewhere, _grasp_otherwise),
    "STILL_HELD": (_place_elsewhere,),
    **dict.fromkeys(("STALLED", "PROTECTIVE_STOP"), (_go_slower,)),
    **dict.fromkeys(("COLLISION_STOP", "TARGET_LIMIT"), (_grasp_otherwise, _place_elsewhere, _go_slower)),
    **dict.fromkeys(("NO_IK", "IN_COLLISION", "NO_PATH_FOUND", "NO_FREE_SITE"), _UNPLANNED),
}
