"""Forms a verdict again from the stored looks, which the runtime's perception processes again.

It is compared with the stored snapshots and the deciding judgement; nothing is recorded.
"""

from collections.abc import Iterable, Sequence

import msgspec

from phyagentos.agent.judging.judges.predicates import evaluate_on
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, Bundle
from phyagentos.protocol.sessions.looks import LookEntry, LookRole
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.predicates.predicate import parse_predicate
from phyagentos.protocol.world.truth import Truth

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


def judge_again(bundle: Bundle, seen: Seen, verifier: SessionVerifier, decision: Attempt | None) -> JudgedAgain:
    """Judge a session on its looks, perceived again, and compare that with the judgement that decided, if any.

    Raises:
        ExecutionError: `LOOK_MISSING`: the bundle does not hold the look of a snapshot.
    """
    again, holds = _replace_snapshots(bundle, seen)
    attempt = verifier.judge(again, History())
    criteria = (*_judge_requires(again), *attempt.criteria)
    recorded = (*_judge_requires(bundle), *verifier.judge(bundle, History()).criteria)
    decided = (*recorded, *(decision.criteria if decision is not None else ()))
    differences = [*_compare_snapshots(bundle, again), *holds, *_compare_criteria(decided, criteria)]
    found, was = attempt.found or attempt.verdict, decision.found if decision is not None else None
    if was is not None and (was is Verdict.SUCCESS) != (found is Verdict.SUCCESS):
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
            raise ExecutionError("LOOK_MISSING", f"{bundle.folder}: no look of the {role}, but a snapshot of it")
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
    for was in recorded:
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
