"""A check that is asked for while another session still runs, so that nobody waits for an order between two sessions.

Upstream: the watchdog. Downstream: the worker, which makes it in the world that the running session leaves. It is a
guess at whose turn comes next, and nothing is recorded of it: when the turn is another's, when the contract was amended
or the claim went elsewhere, it is forgotten and the check is made anew.
"""

from dataclasses import dataclass

from phyagentos.protocol.sessions import Session
from phyagentos.runtime.dispatch import Checked


@dataclass(slots=True)
class Ahead:
    """What was asked, and the answer once it is there.

    Attributes:
        session: The contract as it stood.
        epoch: That its claim will have.
        answer: None while the worker has not told it.
    """

    session: Session
    epoch: int
    answer: Checked | None = None

    def take_in(self, answer: Checked) -> None:
        """Keep an answer, if it is the one that was asked for."""
        if answer.session == self.session.id:
            self.answer = answer

    def fits(self, session: Session, epoch: int) -> bool:
        """Whether this is what a check of that session, under that epoch, would ask."""
        return self.epoch == epoch and self.session == session
