"""What a judge is: the one interface behind which predicates, metrics, monitors, predictions and models stand.

Upstream: the evidence bundle. Downstream: the verifier, which weighs the criteria of all judges alike. The port is
small on purpose: an evaluator of a benchmark stands behind the same one.
"""

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
        ...

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """Every criterion of this kind that the session's contract or the settings hold, each with its evidence."""
        ...


def make_unknown(text: str, kind: str, evidence: str, because: str, *, failure: str | UnsetType = UNSET) -> Criterion:
    """A criterion that is not decided, and why; `failure` is the code of a judge that gave no usable answer."""
    return Criterion(text=text, kind=kind, truth=Truth.UNKNOWN, evidence=evidence, because=because, failure=failure)
