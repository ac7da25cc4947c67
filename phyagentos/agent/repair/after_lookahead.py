"""Repair after a look-ahead below its threshold: the best of the rehearsed alternatives.

The first child keeps the threshold where that alternative meets it. Otherwise, and for further children, it is tried
all the same: giving up achieves less than a failure that can be repaired.
"""

from pathlib import Path

from phyagentos.agent.memory.advice import Advice
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lookahead import Alternative, LookaheadResult, read_lookahead
from phyagentos.protocol.sessions.session import SessionStatus


def revise_refused(refused: SessionStatus, folder: Path) -> Advice | None:
    """The best rehearsed alternative; None without a readable result in `folder`, the session's evidence."""
    try:
        result = read_lookahead(folder)
    except ExecutionError:
        return None
    if result is None:
        return None
    own = Alternative(
        strategy=refused.contract.strategy, samples=result.samples, succeeded=result.succeeded, causes=result.causes
    )
    best = max((own, *result.alternatives), key=lambda each: each.share)
    is_enough = best.share >= result.threshold
    return Advice(
        strategy=best.strategy,
        reasons=(_explain(own, best, result),),
        threshold=None if is_enough and refused.contract.attempt == 0 else 0.0,
    )


def _explain(own: Alternative, best: Alternative, result: LookaheadResult) -> str:
    ahead = f"{own.succeeded:.4g} of {own.samples} {result.cases} succeed, {result.threshold:.0%} are asked"
    cause = f", mostly {own.likely_cause}" if own.likely_cause else ""
    if best is own:
        return f"look-ahead: {ahead}{cause}; none of {len(result.alternatives)} other ways is better, so it is tried"
    return f"look-ahead: {ahead}{cause}; with {best.strategy} it is {best.succeeded:.4g} of {best.samples}"
