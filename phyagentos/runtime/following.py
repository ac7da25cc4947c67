"""Which session follows the running one on its target, so that the end of one and the start of the next are one record.

Upstream: the watchdog. Downstream: the queue, the worker, which checks the next session ahead, and what it answered.
"""

from phyagentos.protocol.sessions import ResetPolicy
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.runtime.ahead import Ahead
from phyagentos.runtime.dispatch import Check, Checked
from phyagentos.runtime.posts import Post
from phyagentos.runtime.queues import Queues
from phyagentos.runtime.register import Register
from phyagentos.runtime.resets import compute_may_reset


def check_ahead(post: Post, queues: Queues, ledger: Ledger) -> None:
    """Have the session checked whose turn probably comes next, as soon as the running one has ended."""
    session = queues.guess_next(post.target)
    if session is not None and session.reset_policy is not ResetPolicy.BETWEEN_GOALS:
        post.ahead = Ahead(session, ledger.sessions[session.id].epoch + 1)
        may_reset = compute_may_reset(session, ledger)
        post.worker.send(Check(session=session, epoch=post.ahead.epoch, may_reset=may_reset))


def find_following(post: Post, queues: Queues, register: Register) -> tuple[Checked, int] | None:
    """The check made ahead and the epoch of the claim, where that session has its turn once the running one has ended.

    None where the check is still to come, found a problem or was made of something else, and where the target has to
    wait for a verdict.
    """
    register.follow()  # a more urgent one may have come
    session, ahead = queues.guess_next(post.target), post.ahead
    if session is None or ahead is None or ahead.answer is None or ahead.answer.plan is None or post.unsure is not None:
        return None
    epoch = register.ledger.sessions[session.id].epoch + 1
    return (ahead.answer, epoch) if ahead.fits(session, epoch) else None
