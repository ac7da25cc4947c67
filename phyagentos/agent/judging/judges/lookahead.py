"""The judge of look-ahead: the chance of true acceptance that was foreseen; it never outvotes an observation."""

from collections.abc import Sequence
from dataclasses import dataclass

from phyagentos.agent.judging.judges.judge import make_unknown
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, LookaheadResult, read_lookahead
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.truth import Truth

KIND = "lookahead"


@dataclass(frozen=True, slots=True)
class LookaheadJudge:
    """Judges the chance of success that was foreseen before the session."""

    name: str = "lookahead/1"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion when a forecast was asked for and made, none otherwise."""
        if bundle.session.lookahead is None:
            return []
        try:
            result = read_lookahead(bundle.folder)
        except ExecutionError as error:
            return [make_unknown(KIND, KIND, LOOKAHEAD, str(error))]
        return [] if result is None or (result.withheld and not result.samples) else [_judge(result)]


def _judge(result: LookaheadResult) -> Criterion:
    text = f"{KIND} >= {result.threshold:g}"
    if result.samples <= 0:
        return make_unknown(text, KIND, LOOKAHEAD, "no rollout came to an end")
    because = f"{result.succeeded:.4g} of {result.samples} {result.cases} met the acceptance"
    if result.likely_cause:
        because += f"; the others failed with {', '.join(f'{c} ({n:.4g})' for c, n in sorted(result.causes.items()))}"
    return Criterion(
        text=text,
        kind=KIND,
        truth=Truth.TRUE if not result.is_low else Truth.FALSE,
        measured={"share": round(result.share, 4), "samples": result.samples, "cost_ms": round(result.cost_ms, 1)},
        evidence=LOOKAHEAD,
        because=because,
    )
