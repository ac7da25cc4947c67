"""The judges of acceptance: as it was observed on the snapshots before and after a session, and as it was foreseen.

A fact about a movable entity counts only when the look at the end shows it, see `Environment.explain_unseen`. What was
foreseen never outvotes an observation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from msgspec import UNSET

from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.judges.judge_registry import FORESEEN, make_unknown
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.predicates.predicate import View, find_question, has_metric, parse_predicate
from phyagentos.protocol.predicates.syntax import HUMAN
from phyagentos.protocol.sessions.answers import get_answer_name, read_answer
from phyagentos.protocol.sessions.evidence import AFTER, Bundle
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, read_lookahead
from phyagentos.protocol.sessions.session import Ended, Execution
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.environment import UNPROVEN, Environment
from phyagentos.protocol.world.truth import Truth

UNANSWERED = "no person has answered"
_LOST = {Ended.RUNNER_LOST, Ended.TARGET_LOST}
_NO_METRICS: Mapping[str, float] = {}


@dataclass(frozen=True, slots=True)
class PredicateJudge:
    """Judges acceptance on the snapshots before and after."""

    name: str = "predicates/2"

    def judge(self, bundle: Bundle) -> Sequence[Criterion]:
        """One criterion for each predicate of `accept` that speaks of no metric, and for each question of a person."""
        return [
            judge_answer(question, "accept", bundle.folder)
            if (question := find_question(text))
            else evaluate_criterion(text, "accept", bundle)
            for text in bundle.session.accept
            if not has_metric(text)
        ]


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
            return [make_unknown(FORESEEN, FORESEEN, LOOKAHEAD, str(error))]
        if result is None or (result.withheld and not result.samples):
            return []
        text = f"{FORESEEN} >= {result.threshold:g}"
        if result.samples <= 0:
            return [make_unknown(text, FORESEEN, LOOKAHEAD, "no rollout came to an end")]
        because = f"{result.succeeded:.4g} of {result.samples} {result.cases} met the acceptance"
        if result.likely_cause:
            others = ", ".join(f"{cause} ({number:.4g})" for cause, number in sorted(result.causes.items()))
            because += f"; the others failed with {others}"
        truth = Truth.FALSE if result.is_low else Truth.TRUE
        measured: dict[str, float | str | bool] = {"share": round(result.share, 4), "samples": result.samples}
        measured["cost_ms"] = round(result.cost_ms, 1)
        return [
            Criterion(text=text, kind=FORESEEN, truth=truth, measured=measured, evidence=LOOKAHEAD, because=because)
        ]


def judge_answer(question: str, kind: str, folder: Path) -> Criterion:
    """What a person answered, as recorded in a folder; unknown before."""
    text = f"{HUMAN} {question}"
    try:
        answer = read_answer(folder, question)
    except ExecutionError as error:
        return make_unknown(text, kind, "", str(error), failure=error.code)
    if answer is None:
        return make_unknown(text, kind, "", UNANSWERED)
    return Criterion(text=text, kind=kind, truth=answer.truth, evidence=get_answer_name(question), because=str(answer))


def evaluate_criterion(
    text: str, kind: str, bundle: Bundle, metrics: Mapping[str, float] = _NO_METRICS, evidence: str = AFTER
) -> Criterion:
    """One predicate on the snapshots of a bundle, and on metrics."""
    if bundle.after is None:
        return make_unknown(text, kind, AFTER, "the world was not observed after the session")
    if bundle.before is not None and _is_older(bundle.after, bundle.before, bundle.execution):
        return make_unknown(text, kind, AFTER, "the snapshot after the session is older than the one before it")
    statuses = {each.status for each in bundle.after.sensors.values()}
    if UNPROVEN in statuses and "live" not in statuses:
        why = "no camera counts its frames or has shown a change, so each may be frozen: move something in its view"
        return make_unknown(text, kind, AFTER, why)
    return evaluate_on(text, kind, bundle.session.make_view(bundle.after, bundle.before, metrics), evidence)


def evaluate_on(text: str, kind: str, view: View, evidence: str) -> Criterion:
    """One predicate on snapshots; text that is no predicate is unknown, with the reason."""
    try:
        evaluation = parse_predicate(text).evaluate(view)
    except DefinitionError as error:
        return make_unknown(text, kind, evidence, str(error))
    return Criterion(
        text=text,
        kind=kind,
        truth=evaluation.truth,
        measured=evaluation.measured,
        evidence=evidence,
        at_s=view.now.time_s,
        because=evaluation.because,
        alternatives=evaluation.alternatives or UNSET,
        failure=Cause.BROKEN_PYTHON if evaluation.defect else UNSET,
    )


def _is_older(after: Environment, before: Environment, execution: Execution) -> bool:
    """A world that began anew, because the old one was lost, counts its time and its revisions anew."""
    began_anew = execution.ended in _LOST and after.revision < before.revision
    return after.episode == before.episode and after.time_s < before.time_s and not began_anew
