"""What a repair is decided on: the session that missed its objective, its evidence, its lineage, and what is left.

Upstream: `progress`, from records and evidence alone, so that the same case always leads to the same choice.
Downstream: the alternatives, and the policy that chooses among them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.selector import Choice
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.repair.budget import Left
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Session, SessionStatus
from phyagentos.protocol.sessions.verdicts import Attempt
from phyagentos.protocol.world.environment import Environment


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One session that pursued its node's objective and did not meet it.

    Attributes:
        bundle: Its evidence; `after` is the latest look at the world.
        attempt: Its judgement.
        choice: Skill, target and parameters of its node.
        catalogue: What else there is.
        lineage: All sessions of the node, the oldest first; the last one has just ended.
        replans_left: Children with the same objective that the node may still have.
        left: What the goal may still cost.
        protected: Things that finished nodes have put where they belong.
        time_of: Skill -> mean simulated time of its sessions in this goal [s].
    """

    bundle: Bundle
    attempt: Attempt
    choice: Choice
    catalogue: Catalogue
    lineage: tuple[SessionStatus, ...]
    replans_left: int
    left: Left
    protected: frozenset[str] = frozenset()
    time_of: Mapping[str, float]

    @property
    def session(self) -> Session:
        """The contract that was not met."""
        return self.bundle.session

    @property
    def cause(self) -> Cause:
        """Of the miss."""
        return Cause(self.attempt.cause)

    @property
    def world(self) -> Environment | None:
        """As it was seen last."""
        return self.bundle.after

    @property
    def latest(self) -> Session:
        """The session that the child continues: this one, or what prepared it since."""
        return self.lineage[-1].contract if self.lineage else self.session

    def count_same(self) -> int:
        """Earlier sessions of the node that pursued the objective by the same means and ended with the same cause."""
        return sum(
            1
            for status in self.lineage
            if status.contract.id != self.session.id
            and not status.contract.purpose
            and (status.contract.skill, status.contract.target) == (self.session.skill, self.session.target)
            and (decision := status.decision) is not None
            and decision.cause == self.attempt.cause
        )

    def find_prepared(self, purpose: str) -> list[Session]:
        """What was done with this purpose since the session that is judged here."""
        ids = [status.contract.id for status in self.lineage]
        since = ids.index(self.session.id) + 1 if self.session.id in ids else len(ids)
        return [s.contract for s in self.lineage[since:] if s.contract.purpose == purpose]
