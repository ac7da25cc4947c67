"""The episodic level: one compact record for each judged session. Paper section 4.3.

An episode repeats nothing of the evidence; it points there.
"""

import msgspec

from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.memory.features import Features, Surroundings
from phyagentos.protocol.sessions.lifecycle import SessionState
from phyagentos.protocol.sessions.memory_entries import Embodiment
from phyagentos.protocol.sessions.session import Session, SessionStatus
from phyagentos.protocol.sessions.strategy import OWN_WAY, Strategy
from phyagentos.protocol.sessions.verdicts import Verdict

JUDGED = frozenset({SessionState.SUCCEEDED, SessionState.FAILED, SessionState.REPLANNED})
INTERRUPTIONS = frozenset({Cause.RUNNER_LOST, Cause.TARGET_LOST, Cause.CANCELLED})


class Episode(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One session, ended and judged.

    Attributes:
        parent: The session that it revises, None for the first of a node.
        seed: Of the scene: sessions of one seed begin from the same start.
        features: What it was about.
        strategy: What was done differently from the skill's own way.
        advised_by: Entries of memory that asked for that.
        verdict: By the evidence, also where the mode of verification let something else decide.
        purpose: As the contract has it: `inspect` or `clear` when it prepared another attempt, empty for an attempt.
        sensing: What the judgement rests on, `truth` or `perceived`.
        evidence: Bundle, relative to the workspace; its whole path where the memory is outside.
        judged_at: Wall time of the verdict, UTC; distinguishes sessions of one name in two workspaces.
    """

    session: str
    goal: str
    node: str
    objective: str
    skill: str
    target: str
    scene: str
    seed: int
    verdict: Verdict
    parent: str | None = None
    body: Embodiment = Embodiment()
    features: Features = Features()
    strategy: Strategy = OWN_WAY
    advised_by: tuple[str, ...] = ()
    cause: str = ""
    purpose: str = ""
    sensing: str = ""
    evidence: str = ""
    judged_at: str = ""

    @property
    def key(self) -> str:
        """Distinguishes it from every other episode."""
        return f"{self.session} {self.judged_at}"

    @property
    def is_success(self) -> bool:
        """Whether its verdict is success."""
        return self.verdict is Verdict.SUCCESS

    @property
    def is_interrupted(self) -> bool:
        """Whether an outside event ended it; then it speaks neither for its way nor against it."""
        return not self.is_success and self.cause in INTERRUPTIONS

    @property
    def is_first(self) -> bool:
        """Whether it is the first attempt of its node."""
        return self.parent is None and not self.purpose


def find_key(status: SessionStatus) -> str:
    """The key of a session's episode."""
    return f"{status.contract.id} {status.updated_at}"


def find_episode(status: SessionStatus, surroundings: Surroundings) -> Episode | None:
    """The episode of a session; None while its verdict is open, when it serves no goal, or had nothing to do."""
    decision = status.decision
    if status.state not in JUDGED or decision is None or not status.contract.goal:
        return None
    if status.execution is not None and status.execution.is_idle:
        return None
    contract: Session = status.contract
    return Episode(
        session=contract.id,
        goal=contract.goal,
        node=contract.node,
        parent=contract.parent,
        objective=contract.objective,
        skill=contract.skill,
        target=contract.target,
        body=surroundings.describe_target(contract.target),
        scene=contract.scene.name,
        seed=contract.scene.seed,
        features=surroundings.describe(contract),
        strategy=contract.strategy,
        advised_by=contract.advised_by,
        verdict=decision.found or decision.verdict,  # in an audit the controller's word decides; it is no experience
        cause=decision.cause,
        purpose=status.contract.purpose,
        sensing=decision.sensing,
        evidence=status.execution.evidence if status.execution else "",
        judged_at=status.updated_at,
    )
