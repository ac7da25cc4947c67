"""Adds a judgement to a session that has its verdict; nothing else changes."""

import msgspec

from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.sessions.lifecycle import REVIEW, list_triggers
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry
from phyagentos.store.journal import Journal


def review_session(workspace: Workspace, journal: Journal, status: SessionStatus, verifier: SessionVerifier) -> Attempt:
    """Judge a session once more and record it; earlier judgements and the session's state stay.

    Raises:
        DefinitionError: `NOT_JUDGED` when it has no verdict yet, or was never executed.
    """
    id = status.contract.id
    if REVIEW not in list_triggers(status.state) or status.execution is None:
        hint = "'paos judge' judges what waits for a verdict." if status.execution is not None else ""
        raise DefinitionError(
            Problem(
                code="NOT_JUDGED",
                address=f"session {id}",
                found=f"state {status.state}",
                expected="a session that was executed and has its verdict",
                hint=hint,
            )
        )
    attempt = verifier.judge(Evidence(workspace.root).read(status), History())
    attempt = msgspec.structs.replace(attempt, is_review=True)
    journal.commit([Entry(id, REVIEW, {"attempt": attempt})])
    return attempt
