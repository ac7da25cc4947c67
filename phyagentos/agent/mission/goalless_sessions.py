"""Verdicts of sessions without a goal, which a person or another program submitted by hand.

No mission judges such a session. It has no node and so no budget: it succeeds or fails, and another attempt is a new
session.
"""

from collections.abc import Iterator

from phyagentos.agent.judging.goal_judgement import Evidence
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.protocol.sessions.lifecycle import IllegalTransition, SessionState
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Journal
from phyagentos.store.ledger import Ledger

_TRIGGERS = {Verdict.SUCCESS: "accept", Verdict.UNVERIFIED: "skip"}


def judge_goalless_sessions(
    workspace: Workspace, journal: Journal, verifier: SessionVerifier | None = None
) -> list[tuple[SessionId, Attempt]]:
    """Judge every session without a goal that awaits a verdict, the longest waiting first.

    Args:
        workspace: With the evidence.
        journal: Opened for the agent's side.
        verifier: The default one when None.

    Returns:
        The verdicts that were recorded.
    """
    verifier = verifier or SessionVerifier()
    ledger, follower = Ledger(), Follower(journal.folder)
    for record in follower.read_new():
        ledger.apply(record)
    follower.close()
    judged = []
    for status in list(_iter_waiting(ledger)):
        attempt = verifier.judge(Evidence(workspace.root).read(status), History())
        trigger = _TRIGGERS.get(attempt.verdict, "refuse")
        verdict = Entry(status.contract.id, trigger, {"attempt": attempt}, status.epoch)
        begin = [] if status.state == SessionState.VERIFYING else [Entry(status.contract.id, "verify")]
        try:
            journal.commit([*begin, verdict])
        except IllegalTransition:  # judged or cancelled by another process meanwhile
            continue
        judged.append((status.contract.id, attempt))
    return judged


def _iter_waiting(ledger: Ledger) -> Iterator[SessionStatus]:
    waiting = (SessionState.VERIFYING, SessionState.AWAITING_VERIFICATION)
    return (status for status in ledger.live_sessions() if not status.contract.goal and status.state in waiting)
