"""Judges: each reads an evidence bundle and answers with criteria; the verifier composes them. Paper section 4.2.

The port is small on purpose: an evaluator of a benchmark or a model that looks at pictures stands behind the same one,
and its criteria are weighed like any other.
"""

from collections.abc import Sequence
from typing import Protocol

from phyagentos.errors import DefinitionError
from phyagentos.protocol.environment import Environment
from phyagentos.protocol.evidence import AFTER, HOLDS, Bundle
from phyagentos.protocol.predicates.predicate import View, parse_predicate
from phyagentos.protocol.verdicts import Criterion, Truth


class Judge(Protocol):
    """Answers for one kind of criterion."""

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """Every criterion of this kind that the session's contract holds, each with its evidence."""
        ...


class PredicateJudge:
    """Judges acceptance on the snapshots before and after."""

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate of `accept`."""
        return [evaluate_criterion(text, "accept", bundle) for text in bundle.session.accept]


class HoldJudge:
    """Judges conditions that had to hold all through, on the worst samples that the recorder kept."""

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate of `hold`; one without a sample is unknown."""
        sampled = {criterion.text: criterion for criterion in bundle.holds}
        return [
            sampled.get(text) or _unknown(text, "hold", HOLDS, "it was never sampled") for text in bundle.session.hold
        ]


def evaluate_criterion(text: str, kind: str, bundle: Bundle) -> Criterion:
    """One predicate on the snapshots of a bundle."""
    if bundle.after is None:
        return _unknown(text, kind, AFTER, "the world was not observed after the session")
    return evaluate_on(text, kind, bundle.after, bundle.before, target=bundle.session.target, evidence=AFTER)


def evaluate_on(
    text: str, kind: str, now: Environment, initial: Environment | None, *, target: str | None, evidence: str
) -> Criterion:
    """One predicate on two snapshots; text that is no predicate is unknown, with the reason."""
    try:
        evaluation = parse_predicate(text).evaluate(View(now=now, initial=initial, target=target))
    except DefinitionError as error:
        return _unknown(text, kind, evidence, str(error))
    return Criterion(
        text=text,
        kind=kind,
        truth=evaluation.truth,
        measured=evaluation.measured,
        evidence=evidence,
        at_s=now.time_s,
        because=evaluation.because,
    )


def _unknown(text: str, kind: str, evidence: str, because: str) -> Criterion:
    return Criterion(text=text, kind=kind, truth=Truth.UNKNOWN, evidence=evidence, because=because)
