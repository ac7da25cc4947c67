"""The judge of conditions that hold all through: "never spilled", "always upright", "never pressed hard".

It judges the recorded worst sample of each; conditions on metrics alone use every control period of the trajectory.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from phyagentos.agent.judging.judges.judge import make_unknown
from phyagentos.agent.judging.judges.metrics import read_metrics
from phyagentos.agent.judging.judges.predicates import evaluate_criterion
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.evidence import EXECUTION, HOLDS, TRAJECTORY, Bundle
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.predicates.predicate import is_metric_only, iter_metrics, parse_predicate
from phyagentos.protocol.world.truth import Truth


@dataclass(frozen=True, slots=True)
class HoldJudge:
    """Judges conditions that had to hold all through, on the worst that was recorded."""

    name: str = "holds/2"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate of `hold`; unknown without a sample."""
        sampled = {criterion.text: criterion for criterion in bundle.holds}
        return [_judge(text, sampled.get(text), bundle) for text in bundle.session.hold]


def _judge(text: str, sampled: Criterion | None, bundle: Bundle) -> Criterion:
    if sampled is not None and sampled.truth is Truth.FALSE:
        return sampled
    if _is_metric_only(text):  # the last sample may be older than the last spike
        if bundle.execution.is_idle:
            because = f"{bundle.execution.code}: no control period was commanded"
            return Criterion(text=text, kind="hold", truth=Truth.TRUE, evidence=EXECUTION, because=because)
        metrics = read_metrics(bundle, set(iter_metrics(text)))
        return evaluate_criterion(text, "hold", bundle, metrics, evidence=TRAJECTORY)
    return sampled or make_unknown(text, "hold", HOLDS, "it was never sampled")


def _is_metric_only(text: str) -> bool:
    try:
        return is_metric_only(parse_predicate(text))
    except DefinitionError:
        return False
