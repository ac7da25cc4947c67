"""The class of what preflight refused, as this benchmark counts it."""

from collections.abc import Sequence

from phyagentos.agent.judging.causes import CauseClass
from phyagentos.errors import Problem

_REFUSALS = {
    "OBSERVATION_": CauseClass.PERCEPTION,
    "SENSOR_": CauseClass.PERCEPTION,
    "POLICY_": CauseClass.POLICY,
    "OUT_OF_REACH": CauseClass.PLANNING,
    "OUTSIDE_WORKSPACE": CauseClass.PLANNING,
    "TOO_WIDE": CauseClass.PLANNING,
    "TOO_HEAVY": CauseClass.PLANNING,
    "TOO_SLIPPERY": CauseClass.PLANNING,
    "NO_SPACE": CauseClass.PLANNING,
    "NO_FREE_SITE": CauseClass.PLANNING,
    "START_OUTSIDE": CauseClass.SAFETY,
    "LIMIT_": CauseClass.SAFETY,
    "TARGET_UNAVAILABLE": CauseClass.MACHINE,
    "TARGET_LOST": CauseClass.MACHINE,
    "PRECONDITION_UNMET": CauseClass.DISTURBANCE,
}
"""Codes of preflight, or how they begin, and their class."""


def classify_refusal(problems: Sequence[Problem]) -> CauseClass:
    """The class of what preflight refused, by the first problem; what does not fit is the adapters'."""
    code = problems[0].code if problems else ""
    for prefix, kind in _REFUSALS.items():
        if code.startswith(prefix):
            return kind
    return CauseClass.ADAPTER if code else CauseClass.OTHER
