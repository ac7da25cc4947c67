"""Which session follows the running one on its target, so that the end of one and the start of the next are one record.

Upstream: the watchdog. Downstream: the queue, or the agent's outlook where nothing waits; the worker, which checks the
next session ahead, and what it answered.
"""

from phyagentos.protocol.sessions.outlook import Outlook
from phyagentos.protocol.sessions.session import ResetPolicy, Session
from phyagentos.runtime.supervision.ahead import Ahead
from phyagentos.runtime.supervision.queues import Queues
from phyagentos.runtime.supervision.resets import compute_may_reset
from phyagentos.runtime.supervision.supervisor_journal import SupervisorJournal
from phyagentos.runtime.supervision.target_supervisor import TargetSupervisor
from phyagentos.runtime.worker.orders import Check, Checked
from phyagentos.store.ledger import Ledger


def order_check(post: TargetSupervisor, session: Session, epoch: int, ledger: Ledger) -> None:
    """Have a session that was submitted checked, under the epoch that its claim will have."""
    post.worker.send(Check(session=session, epoch=epoch, may_reset=compute_may_reset(session, ledger)))


def check_ahead(post: TargetSupervisor, queues: Queues, ledger: Ledger, outlook: Outlook) -> None:
    """Have the session checked whose turn probably comes next, as soon as the running one has ended."""
    session = queues.guess_next(post.target)
    expected = _find_expected(post, ledger, outlook) if session is None else None
    if session is not None and session.reset_policy is not ResetPolicy.BETWEEN_GOALS:
        post.ahead = Ahead(session, ledger.sessions[session.id].epoch + 1)
        order_check(post, session, post.ahead.epoch, ledger)
    elif expected is not None:
        post.ahead = Ahead(expected, 1)
        post.worker.send(Check(session=expected, epoch=1, may_reset=False, is_expected=True))


def _find_expected(post: TargetSupervisor, ledger: Ledger, outlook: Outlook) -> Session | None:
    """What the agent will probably submit, where a check of it changes nothing in the world that is still to be judged.

    None too where it would take long, since something else may be submitted.
    """
    expected, running = outlook.find(post.target), post.session
    if expected is None or running is None or expected.id in ledger.sessions:
        return None
    is_cheap = expected.scene == running.scene and expected.lookahead is None and not expected.resources
    return expected if is_cheap and expected.goal == running.goal else None


def find_following(
    post: TargetSupervisor, queues: Queues, register: SupervisorJournal, now_s: float
) -> tuple[Checked, int] | None:
    """The check made ahead and the epoch of the claim, where that session has its turn once the running one has ended.

    None where the check is still to come, found a problem or was made of something else, and where the target has to
    wait for a verdict.
    """
    register.follow()  # a more urgent one may have come
    session, ahead = queues.guess_next(post.target), post.ahead
    if session is None or ahead is None or ahead.answer is None or ahead.answer.plan is None or post.unsure is not None:
        return None
    epoch = register.ledger.sessions[session.id].epoch + 1
    return (ahead.answer, epoch) if ahead.fits(session, epoch, now_s) else None
