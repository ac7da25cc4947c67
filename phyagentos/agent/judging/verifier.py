"""SessionVerifier: V(G, S0, ST, trace, history) -> success, failure or replan. Paper section 4.2.

The end of the execution makes no success and prevents none; only criteria on evidence decide. Whether the verdict
takes effect depends on the mode, see `VerificationMode`.
"""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.judging.deciding import find_least_certain
from phyagentos.agent.judging.diagnosis import Diagnosis, diagnose
from phyagentos.agent.judging.judges.judge_registry import FORESEEN, Judge, make_unknown
from phyagentos.agent.judging.judges.metrics import HoldJudge, MetricJudge
from phyagentos.agent.judging.judges.predicates import LookaheadJudge, PredicateJudge
from phyagentos.protocol.predicates.predicate import find_objects
from phyagentos.protocol.sessions.answers import ANSWERS
from phyagentos.protocol.sessions.evidence import Bundle, refer_to
from phyagentos.protocol.sessions.evidence_manifest import get_shown_name
from phyagentos.protocol.sessions.lessons import Lesson
from phyagentos.protocol.sessions.session import Ended, Session, SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, EvidenceReference, Verdict
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.wording import count, count_criteria

DEFAULT_JUDGES: tuple[Judge, ...] = (PredicateJudge(), HoldJudge(), MetricJudge(), LookaheadJudge())
MOST_MISSING = 8  # a child session looks at one entity, or at a few that stand together
MOST_REFERENCES = 64  # a bundle has fewer files that can be judged on, contexts of models included


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """What the judgement has to know of the node's earlier sessions.

    Attributes:
        replans: Children that the node has had, of at most `max_replans`.
        carried: Conditions that earlier sessions of the node could not see all through, as they stand now.
        prior: Earlier sessions of the node, the oldest first; judges and diagnosis find them in the bundle.
        lessons: Lessons in force for the session, likewise. Neither changes a verdict by itself.
    """

    replans: int = 0
    max_replans: int = 0
    carried: tuple[Criterion, ...] = ()
    prior: tuple[SessionStatus, ...] = ()
    lessons: tuple[Lesson, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionVerifier:
    """Composes judges and decides; `costly` ones are asked after the others, and only while nothing is false."""

    judges: Sequence[Judge] = DEFAULT_JUDGES
    costly: Sequence[Judge] = ()
    mode: VerificationMode = VerificationMode.RECOVERY
    name: str = "session_verifier/2"

    def judge(self, bundle: Bundle, history: History) -> Attempt:
        """One judgement.

        Success needs every criterion to be true. Otherwise the session is replanned while the cause can be mended
        and the budget lasts, else it has failed. When nothing is false and something is unknown, the cause is
        `EVIDENCE_MISSING`, and `missing_evidence` names the entities to look at again.
        """
        if self.mode is VerificationMode.OFF:
            reason = f"verification is off, no judge ran: the execution ended {bundle.execution.ended}."
            off = Attempt(verdict=Verdict.UNVERIFIED, criteria=(), reason=reason, sensing="none", verifier=self.name)
            return msgspec.structs.replace(off, mode=self.mode)
        if self.mode is VerificationMode.ENFORCE:
            history = replace(history, max_replans=0)
        bundle = msgspec.structs.replace(bundle, prior=history.prior, lessons=history.lessons)
        criteria = [*(criterion for judge in self.judges for criterion in judge.judge(bundle)), *history.carried]
        for judge in self.costly:
            if all(each.truth is not Truth.FALSE for each in _choose_decisive(criteria)):
                criteria += judge.judge(bundle)
        criteria += _find_unanswered(bundle.session, criteria)
        attempt = self._weigh(bundle, history, tuple(criteria))
        return _audit(attempt, bundle) if self.mode is VerificationMode.AUDIT else attempt

    def _weigh(self, bundle: Bundle, history: History, criteria: tuple[Criterion, ...]) -> Attempt:
        decisive = _choose_decisive(criteria)
        if decisive and all(criterion.truth is Truth.TRUE for criterion in decisive):
            reason = _explain_success(bundle, decisive)
            return self._sign(bundle, criteria, verdict=Verdict.SUCCESS, reason=reason)
        diagnosis, missing = _find_reason(bundle, decisive)
        has_budget = history.replans < history.max_replans
        verdict = Verdict.REPLAN if has_budget and not diagnosis.is_hopeless else Verdict.FAILURE
        reason = f"{_explain(diagnosis, decisive)} {self._explain_decision(diagnosis, history, missing)}"
        found = {"cause": diagnosis.cause.value, "kind": diagnosis.kind.value, "support": diagnosis.support}
        return self._sign(bundle, criteria, verdict=verdict, reason=reason, missing_evidence=missing, **found)

    def _sign(self, bundle: Bundle, criteria: tuple[Criterion, ...], *, verdict: Verdict, **more: Any) -> Attempt:
        return Attempt(
            verdict=verdict,
            criteria=criteria,
            sensing=bundle.after.sensing if bundle.after else "none",
            verifier=self.name,
            mode=self.mode,
            judges=tuple(judge.name for judge in (*self.judges, *self.costly)),
            found=verdict,
            evidence=_refer(bundle, criteria),
            idealisations=bundle.execution.idealisations,
            **more,
        )

    def _explain_decision(self, diagnosis: Diagnosis, history: History, missing: Sequence[str]) -> str:
        if diagnosis.is_hopeless:
            return "Another attempt cannot help."
        if self.mode is VerificationMode.ENFORCE:
            other = f"; `--verify recovery` looks again at {', '.join(missing)}" if missing else ""
            return f"Nothing is replanned: verification only enforces{other}."
        if history.replans >= history.max_replans:
            return f"The budget of {count(history.max_replans, 'replan')} is spent."
        look = f"First look again at {', '.join(missing)}. " if missing else ""
        return f"{look}Replan {history.replans + 1} of {history.max_replans}."


def _choose_decisive(criteria: Sequence[Criterion]) -> Sequence[Criterion]:
    """The observed criteria; predictions only where nothing was observed."""
    observed = [criterion for criterion in criteria if criterion.kind != FORESEEN]
    return observed or criteria


def _find_unanswered(session: Session, criteria: Sequence[Criterion]) -> Iterator[Criterion]:
    """Criteria of the contract that no judge answered: unknown, lest they count as met."""
    for kind, other, texts in (("accept", "hold", session.accept), ("hold", "accept", session.hold)):
        answered = {each.text for each in criteria if each.kind != FORESEEN and each.kind != other}
        for text in texts:
            if text not in answered:
                yield make_unknown(text, kind, "", "no judge of this session answers it")


def _find_reason(bundle: Bundle, criteria: Sequence[Criterion]) -> tuple[Diagnosis, tuple[str, ...]]:
    """The diagnosis, and the entities to look at again."""
    diagnosis = diagnose(bundle, criteria)
    is_closed = any(each.truth is Truth.FALSE or each.alternatives for each in criteria)  # no look tells alike apart
    judged = [each for each in criteria if each.evidence]  # a look helps where a judge's evidence was not enough
    missing = () if is_closed else find_missing_evidence(judged, bundle.after)
    is_settled = diagnosis.is_hopeless and (
        diagnosis.cause is Cause.BROKEN_PYTHON or bundle.after is None or bundle.after.sensing == "truth"
    )
    if not missing or bundle.after is None or is_settled:
        return diagnosis, ()
    if diagnosis.cause is not Cause.EVIDENCE_MISSING:
        fact = f"{', '.join(missing)} must be seen again"
        diagnosis = replace(diagnosis, cause=Cause.EVIDENCE_MISSING, fact=fact, criterion="")
    return replace(diagnosis, is_hopeless=False), missing


def _audit(attempt: Attempt, bundle: Bundle) -> Attempt:
    """The same judgement, with the execution's own report as verdict."""
    ended = bundle.execution.ended
    verdict = Verdict.SUCCESS if ended is Ended.COMPLETED else Verdict.FAILURE
    reason = f"audit: the execution ended {ended}, which decides; the evidence shows {attempt.found}. {attempt.reason}"
    cause = attempt.cause or (diagnose(bundle, attempt.criteria).cause.value if verdict.is_miss else "")
    return msgspec.structs.replace(attempt, verdict=verdict, cause=cause, reason=reason)


def find_missing_evidence(criteria: Sequence[Criterion], after: Environment | None) -> tuple[str, ...]:
    """Entities of acceptance and constraints that the last snapshot does not show well enough, in their order."""
    if after is None:
        return ()
    unknown = [each for each in criteria if each.kind in {"accept", "constraint"} and each.truth is Truth.UNKNOWN]
    found: dict[str, None] = {}
    for objects in (find_objects(each.text, after) for each in unknown):
        unseen = [name for name in objects if not after.shows(name)]
        if not unseen and after.sensing != "truth":  # seen, not sharply
            seen = [after.entities[name] for name in objects if name in after.entities]
            least = find_least_certain(seen)  # of what is fixed it alone is worth a look
            unseen = [each.name for each in seen if each.movable or each is least]
        found |= dict.fromkeys(unseen)
    return tuple(found)[:MOST_MISSING]


def _refer(bundle: Bundle, criteria: Sequence[Criterion]) -> tuple[EvidenceReference, ...]:
    """The files that were read: those of the bundle, and those that judges opened themselves."""
    known = {reference.file for reference in bundle.references}
    references = list(bundle.references)
    for name in dict.fromkeys(criterion.evidence for criterion in criteria):
        if name and name not in known and "/" not in name.removeprefix(ANSWERS):
            with contextlib.suppress(OSError):  # the judge found none either and reported it
                references.append(refer_to(name, (bundle.folder / name).read_bytes()))
    shown = dict.fromkeys(criterion.shown for criterion in criteria if criterion.shown is not msgspec.UNSET)
    references += [EvidenceReference(file=get_shown_name(sha256), sha256=sha256) for sha256 in shown]
    return tuple(references[:MOST_REFERENCES])


def _explain_success(bundle: Bundle, criteria: Sequence[Criterion]) -> str:
    text, execution = count_criteria(len(criteria), len(criteria)), bundle.execution
    if execution.ended is Ended.COMPLETED:
        return f"{text}; {execution.code}: {execution.message}" if execution.code else text
    return f"{text}, although the execution ended {execution.ended}"


def _explain(diagnosis: Diagnosis, criteria: Sequence[Criterion]) -> str:
    ranked = sorted((each for each in criteria if each.truth is not Truth.TRUE), key=lambda e: e.truth is Truth.UNKNOWN)
    more = [_explain_criterion(each) for each in ranked[:1] if each.text != diagnosis.criterion]
    return " ".join(f"{sentence}." for sentence in (diagnosis.fact, *more))


def _explain_criterion(criterion: Criterion) -> str:
    """The fact behind a false criterion, which says which one it is; of any other, the criterion as well."""
    is_plain = criterion.truth is Truth.FALSE and criterion.because
    return criterion.because if is_plain else f"{criterion.text} is {criterion.truth}: {criterion.because}"
