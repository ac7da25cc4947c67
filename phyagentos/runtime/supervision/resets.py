"""Whether the world of a target may be begun anew for a session. Upstream: contract, ledger. Downstream: the target.

The target itself refuses (`RESET_FORBIDDEN`); what other goals still have in its world only the watchdog knows.
"""

from phyagentos.protocol.sessions.lifecycle import FINAL_STATES
from phyagentos.protocol.sessions.session import ResetPolicy, Session, SessionStatus
from phyagentos.store.ledger import Ledger


def compute_may_reset(session: Session, ledger: Ledger) -> bool:
    """Whether another episode may end for this session.

    Args:
        session: The contract.
        ledger: Every session that is not over.
    """
    if session.reset_policy is not ResetPolicy.BETWEEN_GOALS:
        return session.reset_policy is ResetPolicy.ON_NEW_EPISODE
    return not any(
        status.contract.target == session.target
        and status.contract.scene.episode != session.scene.episode
        and status.epoch
        and _matters(status, ledger)
        for status in ledger.sessions.values()
    )


def _matters(status: SessionStatus, ledger: Ledger) -> bool:
    """Whether somebody still counts on what this session, which was claimed, did to its world."""
    goal = ledger.goals.get(status.contract.goal)
    return status.state not in FINAL_STATES or (goal is not None and not goal.verdict and not goal.is_cancelled)
