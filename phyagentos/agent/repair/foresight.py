"""What follows from a look-ahead that went too badly: another way, chosen among those that were rehearsed.

Upstream: a session that preflight refused with `LOOKAHEAD_LOW`, and the result in its evidence. Downstream: `recovery`,
which compiles the child. Nothing has moved by then. The first session's child is looked ahead under the same threshold
where its way was likely enough to succeed; otherwise, and for the children of children, the best way known is tried all
the same: to give up achieves less than a try whose failure can be repaired.
"""

from pathlib import Path

from phyagentos.agent.memory.advice import Advice
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lookahead import Alternative, LookaheadResult, read_lookahead
from phyagentos.protocol.sessions.session import SessionStatus


def revise_foreseen(refused: SessionStatus, folder: Path) -> Advice | None:
    """The best way that was rehearsed; None when nothing is worth a try.

    Args:
        refused: The rejected session.
        folder: Its evidence; without a readable result there is nothing to go by.
    """
    try:
        result = read_lookahead(folder)
    except ExecutionError:
        return None
    if result is None:
        return None
    own = Alternative(
        strategy=refused.contract.strategy,
        samples=result.samples,
        succeeded=result.succeeded,
        causes=result.causes,
    )
    best = max((own, *result.alternatives), key=lambda each: each.share)
    is_enough = best.share >= result.threshold
    return Advice(
        strategy=best.strategy,
        reasons=(_explain(own, best, result),),
        threshold=None if is_enough and refused.contract.attempt == 0 else 0.0,
    )


def _explain(own: Alternative, best: Alternative, result: LookaheadResult) -> str:
    ahead = f"{own.succeeded} of {own.samples} rollouts succeed, {result.threshold:.0%} are asked"
    cause = f", mostly {own.likely_cause}" if own.likely_cause else ""
    if best is own:
        return f"look-ahead: {ahead}{cause}; none of {len(result.alternatives)} other ways is better, so it is tried"
    return f"look-ahead: {ahead}{cause}; with {best.strategy} it is {best.succeeded} of {best.samples}"
