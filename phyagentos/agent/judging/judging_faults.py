"""Faults of the judging itself: criteria contradict, judges disagree, or a judge failed while all else is true.

They are found from the criteria alone, before a cause is searched in the world.
"""

from collections.abc import Iterator, Sequence
from itertools import chain

from msgspec import UNSET

from phyagentos.agent.judging.causes import Cause
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.predicates.predicate import find_formula
from phyagentos.protocol.world.predicates.syntax import And, Formula, Not, render
from phyagentos.protocol.world.truth import Truth

_OF_THE_WAY = frozenset({"hold", "constraint", "metric", "requires"})
"""Kinds that speak of other moments than the end."""


def find_judging_fault(criteria: Sequence[Criterion]) -> tuple[Cause, str] | None:
    """The verifier's own fault and the deciding fact in words; None when there is none."""
    criteria = [criterion for criterion in criteria if criterion.kind != "lookahead"]
    return _find_contradiction(criteria) or _find_dispute(criteria) or _find_silence(criteria)


def _find_contradiction(criteria: Sequence[Criterion]) -> tuple[Cause, str] | None:
    """Two criteria on the end that exclude one another."""
    texts = dict.fromkeys(criterion.text for criterion in criteria if criterion.kind not in _OF_THE_WAY)
    demands = set(chain.from_iterable(_iter_demands(text) for text in texts))
    for demand in sorted((each for each in demands if isinstance(each, Not)), key=render):
        if demand.body in demands:
            fact = f"{render(demand.body)} and {render(demand)} are both asked for, and no world meets both"
            return Cause.CRITERIA_CONTRADICT, fact
    return None


def _find_dispute(criteria: Sequence[Criterion]) -> tuple[Cause, str] | None:
    """Every false criterion is true to another judge."""
    believed = {each.text: each for each in criteria if each.truth is Truth.TRUE and each.kind not in _OF_THE_WAY}
    denied = [criterion for criterion in criteria if criterion.truth is Truth.FALSE]
    if not denied or any(each.text not in believed or each.kind in _OF_THE_WAY for each in denied):
        return None
    worst = denied[0]
    known = believed[worst.text]
    fact = f"{worst.text} is true to {known.kind} ({known.because}) and false to {worst.kind} ({worst.because})"
    return Cause.JUDGES_DISAGREE, fact


def _find_silence(criteria: Sequence[Criterion]) -> tuple[Cause, str] | None:
    """Only criteria without a judge's answer are open."""
    unknown = [criterion for criterion in criteria if criterion.truth is Truth.UNKNOWN]
    if not unknown or any(criterion.truth is Truth.FALSE for criterion in criteria):
        return None
    if any(criterion.failure is UNSET for criterion in unknown):
        return None
    return Cause.JUDGE_FAILED, f"{unknown[0].text} was not judged by {unknown[0].kind}: {unknown[0].because}"


def _iter_demands(text: str) -> Iterator[Formula]:
    """The parts of a criterion that must all be true."""
    formula = find_formula(text)
    if formula is None:
        return  # its judge has called it unknown, and says why
    yield from formula.parts if isinstance(formula, And) else (formula,)
