"""The judge of look-ahead: the chance of true acceptance that was foreseen; it never outvotes an observation."""

from collections.abc import Sequence
from dataclasses import dataclass

from phyagentos.agent.judging.judges.judge_registry import make_unknown
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, read_lookahead
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
        if result is None or (result.withheld and not result.samples):
            return []
        text = f"{KIND} >= {result.threshold:g}"
        if result.samples <= 0:
            return [make_unknown(text, KIND, LOOKAHEAD, "no rollout came to an end")]
        because = f"{result.succeeded:.4g} of {result.samples} {result.cases} met the acceptance"
        if result.likely_cause:
            others = ", ".join(f"{cause} ({number:.4g})" for cause, number in sorted(result.causes.items()))
            because += f"; the others failed with {others}"
        truth = Truth.FALSE if result.is_low else Truth.TRUE
        measured: dict[str, float | str | bool] = {"share": round(result.share, 4), "samples": result.samples}
        measured["cost_ms"] = round(result.cost_ms, 1)
        return [Criterion(text=text, kind=KIND, truth=truth, measured=measured, evidence=LOOKAHEAD, because=because)]
