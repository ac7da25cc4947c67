"""The port of judges: predicates, metrics, monitors, predictions and models; small on purpose."""

from collections.abc import Sequence
from typing import Protocol

from msgspec import UNSET, UnsetType

from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.truth import Truth

ADVISORY_KINDS = frozenset({"lookahead"})
"""Predictions: recorded with every judgement, and decisive only where nothing was observed that could decide."""


class Judge(Protocol):
    """Answers for one kind of criterion."""

    @property
    def name(self) -> str:
        """Name, version and configuration, as recorded with every judgement (`predicates/2`)."""

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """Every criterion of this kind in the session's contract or the settings, each with its evidence."""


def make_unknown(text: str, kind: str, evidence: str, because: str, *, failure: str | UnsetType = UNSET) -> Criterion:
    """An undecided criterion, and why; `failure` is the code of a judge that gave no usable answer."""
    return Criterion(text=text, kind=kind, truth=Truth.UNKNOWN, evidence=evidence, because=because, failure=failure)
