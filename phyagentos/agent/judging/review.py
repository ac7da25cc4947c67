"""Judgements outside a mission: of sessions without a goal, and further ones of judged sessions.

A session without a goal has no node and so no budget: it succeeds or fails, and another attempt is a new session.
"""

import contextlib
from collections.abc import Sequence

import msgspec

from phyagentos.agent.context.of_workspace import find_lessons
from phyagentos.agent.judging.goal_judgement import Evidence, carry_conditions
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.lifecycle import REVIEW, IllegalTransition, SessionState, list_triggers
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry
from phyagentos.store.history import fold_partition
from phyagentos.store.journal import Journal

_WAITING = (SessionState.VERIFYING, SessionState.AWAITING_VERIFICATION)
_TRIGGERS = {Verdict.SUCCESS: "accept", Verdict.UNVERIFIED: "skip"}


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
    what became of them, and the lessons in force.

    Raises:
        DefinitionError: `NOT_JUDGED` when it has no verdict yet, or was never executed.
    """
    id = status.contract.id
    if REVIEW not in list_triggers(status.state) or status.execution is None:
        expected = "a session that was executed and has its verdict"
        hint = "'paos judge' judges what waits for a verdict." if status.execution is not None else ""
        raise DefinitionError.of("NOT_JUDGED", f"session {id}", f"state {status.state}", expected, hint)
    evidence = Evidence(workspace.root)
    bundle = evidence.read(status)
    carried = carry_conditions(status.contract, bundle.after, lineage, evidence)
    lessons = find_lessons(workspace.lessons, status.contract, bundle.before or bundle.after)
    prior = tuple(each for each in lineage if each.contract.attempt < status.contract.attempt)
    attempt = verifier.judge(bundle, History(carried=carried, prior=prior, lessons=lessons))
    attempt = msgspec.structs.replace(attempt, is_review=True)
    journal.commit([Entry(id, REVIEW, {"attempt": attempt})])
    return attempt
