"""Judgements outside a mission: of sessions without a goal, further ones, and those formed again from stored looks.

A session without a goal has no node and so no budget: it succeeds or fails, and another attempt is a new session.
Stored looks are processed again by the runtime's perception; nothing of that is recorded.
"""

import contextlib
from collections.abc import Iterable, Sequence

import msgspec

from phyagentos.agent.context.of_workspace import find_lessons
from phyagentos.agent.judging.goal_judgement import Evidence, carry_conditions
from phyagentos.agent.judging.judges.predicates import evaluate_on
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.predicates.predicate import find_question, parse_predicate
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, Bundle
from phyagentos.protocol.sessions.lifecycle import REVIEW, IllegalTransition, SessionState, list_triggers
from phyagentos.protocol.sessions.looks import LookEntry, LookRole
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.admission import Entry
from phyagentos.store.history import fold_partition
from phyagentos.store.journal import Journal

_WAITING = (SessionState.VERIFYING, SessionState.AWAITING_VERIFICATION)
_TRIGGERS = {Verdict.SUCCESS: "accept", Verdict.UNVERIFIED: "skip"}
Seen = Sequence[tuple[LookEntry, Environment]]
"""Each look of a bundle, and the world as it is perceived from it now."""


class JudgedAgain(msgspec.Struct, frozen=True, kw_only=True):
    """A session, perceived and judged again on so many looks.

    Attributes:
        verdict: Of the criteria; replanning is not weighed again.
        criteria: Preconditions, acceptance and hold conditions as they are now.
        differences: From the record; empty when equal.
    """

    session: str
    verdict: Verdict
    looks: int
    criteria: tuple[Criterion, ...]
    differences: tuple[str, ...]


def judge_goalless_sessions(
    workspace: Workspace, journal: Journal, verifier: SessionVerifier | None = None
) -> list[tuple[SessionId, Attempt]]:
    """Judge every session without a goal that awaits a verdict, the longest waiting first; what was recorded."""
    judged = []
    live = fold_partition(journal.folder).live_sessions()
    for status in (each for each in live if not each.contract.goal and each.state in _WAITING):
        id, bundle = status.contract.id, Evidence(workspace.root).read(status)
        lessons = find_lessons(workspace.lessons, status.contract, bundle.before or bundle.after)
        attempt = (verifier or SessionVerifier()).judge(bundle, History(lessons=lessons))
        verdict = Entry(id, _TRIGGERS.get(attempt.verdict, "refuse"), {"attempt": attempt}, status.epoch)
        begin = [] if status.state == SessionState.VERIFYING else [Entry(id, "verify")]
        with contextlib.suppress(IllegalTransition):  # judged or cancelled by another process meanwhile
            journal.commit([*begin, verdict])
            judged.append((id, attempt))
    return judged


def review_session(
    workspace: Workspace,
    journal: Journal,
    status: SessionStatus,
    verifier: SessionVerifier,
    lineage: Sequence[SessionStatus] = (),
) -> Attempt:
    """Judge a session once more and record it; earlier judgements and the session's state stay.

    Of the `lineage`, the sessions of its node, it takes over the conditions that these could not see; judges are shown
    what became of them, and the lessons in force. Raises DefinitionError `NOT_EXECUTED` where it has no verdict yet, or
    was never executed.
    """
    id = status.contract.id
    if REVIEW not in list_triggers(status.state) or status.execution is None:
        expected = "a session that was executed and has its verdict"
        hint = "'paos judge' judges what waits for a verdict." if status.execution is not None else ""
        raise DefinitionError.of("NOT_EXECUTED", f"session {id}", f"state {status.state}", expected, hint)
    evidence = Evidence(workspace.root)
    bundle = evidence.read(status)
    carried = carry_conditions(status.contract, bundle.after, lineage, evidence)
    lessons = find_lessons(workspace.lessons, status.contract, bundle.before or bundle.after)
    prior = tuple(each for each in lineage if each.contract.attempt < status.contract.attempt)
    attempt = verifier.judge(bundle, History(carried=carried, prior=prior, lessons=lessons))
    attempt = msgspec.structs.replace(attempt, is_review=True)
    journal.commit([Entry(id, REVIEW, {"attempt": attempt})])
    return attempt


def judge_again(bundle: Bundle, seen: Seen, verifier: SessionVerifier, decision: Attempt | None) -> JudgedAgain:
    """Judge a session on its looks, perceived again, and compare that with the judgement that decided, if any.

    Raises ExecutionError `EVIDENCE_DAMAGED` where the bundle does not hold the look of a snapshot.
    """
    again, holds = _replace_snapshots(bundle, seen)
    attempt = verifier.judge(again, History())
    criteria = (*_judge_requires(again), *attempt.criteria)
    recorded = (*_judge_requires(bundle), *verifier.judge(bundle, History()).criteria)
    decided = (*recorded, *(decision.criteria if decision is not None else ()))
    differences = [*_compare_snapshots(bundle, again), *holds, *_compare_criteria(decided, criteria)]
    found, was = attempt.found or attempt.verdict, decision.found if decision is not None else None
    waited = any(find_question(each.text) and each.truth is Truth.UNKNOWN for each in decided)  # answered since
    if was is not None and not waited and (was is Verdict.SUCCESS) != (found is Verdict.SUCCESS):
        differences.append(f"verdict: {attempt.found}, was {was}")
    return JudgedAgain(
        session=bundle.session.id,
        verdict=attempt.verdict,
        looks=len({entry.file for entry, _ in seen}),
        criteria=criteria,
        differences=tuple(dict.fromkeys(differences)),
    )


def _replace_snapshots(bundle: Bundle, seen: Seen) -> tuple[Bundle, list[str]]:
    """The bundle with the new snapshots, and the samples of hold conditions that differ."""
    snapshots = {entry.role: world for entry, world in seen if not entry.text}
    for role, recorded in ((LookRole.START, bundle.before), (LookRole.END, bundle.after)):
        if recorded is not None and role not in snapshots:
            raise ExecutionError("EVIDENCE_DAMAGED", f"{bundle.folder}: no look of the {role}, but a snapshot of it")
    before = snapshots.get(LookRole.START)
    again = msgspec.structs.replace(bundle, before=before, after=snapshots.get(LookRole.END))
    if before is None:
        return again, []
    holds = {criterion.text: criterion for criterion in bundle.holds}
    differences: list[str] = []
    for entry, world in seen:
        if not entry.text:
            continue
        found = parse_predicate(entry.text).evaluate(bundle.session.make_view(world, before, entry.metrics))
        if entry.role is LookRole.WORST and entry.text in holds:
            now = {"truth": found.truth, "measured": found.measured, "because": found.because}
            holds[entry.text] = msgspec.structs.replace(holds[entry.text], **now)
        elif entry.role is LookRole.UNKNOWN and found.truth is not Truth.UNKNOWN:
            differences.append(f"hold {entry.text} at {entry.time_s:.3f} s: {found.truth}, was unknown")
    again = msgspec.structs.replace(again, holds=tuple(holds.values()))
    return again, [*differences, *_compare_criteria(bundle.holds, again.holds)]


def _judge_requires(bundle: Bundle) -> list[Criterion]:
    session, before = bundle.session, bundle.before
    if before is None:
        return []
    return [evaluate_on(text, "requires", session.make_view(before, before), BEFORE) for text in session.requires]


def _compare_criteria(recorded: Iterable[Criterion], again: Iterable[Criterion]) -> Iterable[str]:
    known = {(criterion.kind, criterion.text): criterion for criterion in again}
    for was in (each for each in recorded if not find_question(each.text)):  # no picture shows a person's answer
        if (now := known.get((was.kind, was.text))) is None:
            yield f"{was.kind} {was.text}: not judged again, was {was.truth}"
        elif (now.truth, now.measured) != (was.truth, was.measured):
            yield f"{was.kind} {was.text}: {now.truth} {now.measured}, was {was.truth} {was.measured}"


def _compare_snapshots(bundle: Bundle, again: Bundle) -> Iterable[str]:
    for file, was, now in ((BEFORE, bundle.before, again.before), (AFTER, bundle.after, again.after)):
        if was is None or now is None:
            continue
        names = sorted(was.entities.keys() | now.entities.keys())
        other = [name for name in names if was.entities.get(name) != now.entities.get(name)]
        if other:
            yield f"{file}: {', '.join(other)} perceived otherwise"
