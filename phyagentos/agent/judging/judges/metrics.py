"""The judge of numbers: `metric(name) <= bound`.

Beside the metrics of the trajectory, every number of a leaf or of the session's outputs counts under its own name. An
unmeasured metric is unknown.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from phyagentos.agent.judging.judges.metric_table import TRAJECTORY_METRICS, read_course, read_report
from phyagentos.agent.judging.judges.predicates import evaluate_criterion
from phyagentos.protocol.sessions.evidence import EXECUTION, TRAJECTORY, Bundle
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.predicates.predicate import has_metric, iter_metrics


@dataclass(frozen=True, slots=True)
class MetricJudge:
    """Judges numbers.

    Attributes:
        criteria: Apply to every session, beside the metrics of its own acceptance.
    """

    criteria: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """`metrics/1`, and the criteria for every session."""
        return f"metrics/1({'; '.join(self.criteria)})" if self.criteria else "metrics/1"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate about metrics."""
        asked = [("accept", text) for text in bundle.session.accept if has_metric(text)]
        asked += [("metric", text) for text in self.criteria]
        if not asked:
            return []
        metrics = read_metrics(bundle, {name for _, text in asked for name in iter_metrics(text)})
        return [
            evaluate_criterion(text, kind, bundle, metrics, evidence=_find_source(iter_metrics(text)))
            for kind, text in asked
        ]


def read_metrics(bundle: Bundle, wanted: set[str]) -> Mapping[str, float]:
    """The wanted metrics in the bundle; the trajectory is read only when one of them needs it."""
    found = {name: value for name, value in read_report(bundle) if name not in TRAJECTORY_METRICS}  # that is observed
    if wanted & TRAJECTORY_METRICS.keys():
        found |= read_course(bundle.folder, wanted)
    return {name: value for name, value in found.items() if name in wanted}


def _find_source(names: Iterator[str]) -> str:
    return TRAJECTORY if any(name in TRAJECTORY_METRICS for name in names) else EXECUTION
