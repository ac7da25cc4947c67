"""A check that is asked for while another session still runs, so that nobody waits for an order between two sessions.

Upstream: the watchdog. Downstream: the worker, which makes it in the world that the running session leaves. It is a
guess at whose turn comes next, and nothing is recorded of it: when the turn is another's, when the contract was amended
or the claim went elsewhere, when it found a problem, or when the world has had time to change, it is forgotten and the
check is made anew.
"""

from dataclasses import dataclass

from phyagentos.protocol.sessions.session import Session
from phyagentos.runtime.worker.orders import Checked

FRESH_S = 1.0  # so long a check holds that was made ahead, by the wall clock


@dataclass(slots=True)
class Ahead:
    """What was asked, and the answer once it is there.

    Attributes:
        session: The contract as it stood.
        epoch: That its claim will have.
        answer: None while the worker has not told it.
        until_s: How long the answer holds, by the watchdog's clock [s].
    """

    session: Session
    epoch: int
    answer: Checked | None = None
    until_s: float = 0.0

    def take_in(self, answer: Checked, now_s: float) -> None:
        """Keep an answer, if it is the one that was asked for."""
        if answer.session == self.session.id:
            self.answer, self.until_s = answer, now_s + FRESH_S

    def fits(self, session: Session, epoch: int, now_s: float) -> bool:
        """Whether a check of that session, under that epoch, needs not be asked for: it was, or has passed just now."""
        if self.epoch != epoch or self.session != session:
            return False
        return self.answer is None or (self.answer.plan is not None and now_s <= self.until_s)
