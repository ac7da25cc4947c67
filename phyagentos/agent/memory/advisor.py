"""The advisor: what verified experience advises for a session before it is submitted. Paper section 4.3 (retrieval).

Only the first attempt of a node is advised: a repair rests on fresher evidence.
"""

from phyagentos.agent.memory.advice import NOTHING, Advice
from phyagentos.agent.memory.features import Features, Surroundings
from phyagentos.agent.memory.memory import Found, Memory
from phyagentos.protocol.sessions.memory_entries import Scope
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.strategy import OWN_WAY
from phyagentos.protocol.world.environment import Environment

REMEMBERED = 4096  # answers that are kept until memory changes


class MemoryAdvisor:
    """Advises from memory; see `Advisor`."""

    def __init__(self, memory: Memory, surroundings: Surroundings) -> None:
        self._memory, self._surroundings = memory, surroundings
        self._answers: dict[Scope, Advice] = {}
        self._seq = -1

    def advise(self, session: Session, world: Environment | None) -> Advice:
        """What was verified to help in its scope; nothing for a child, or where nothing is known."""
        del world  # kinds are known from the inventory before anything was seen
        experience = self._memory.experience
        if session.parent is not None or session.purpose or not (experience.corrections or experience.patterns):
            return NOTHING
        if self._seq != experience.seq or len(self._answers) > REMEMBERED:
            self._answers, self._seq = {}, experience.seq
        features = self._surroundings.describe(session)
        scope = make_scope(session, features, self._surroundings)
        if scope not in self._answers:
            self._answers[scope] = self._find(scope)
        return self._answers[scope]

    def _find(self, scope: Scope) -> Advice:
        found = self._memory.recall(scope)
        promoted = self._memory.find_promoted(scope)
        strategy = OWN_WAY
        used: list[Found] = []
        for each in found:
            if strategy.changed.isdisjoint(each.lesson.advice.changed):  # of two that disagree the better one
                strategy = strategy.join(each.lesson.advice)
                used.append(each)
        reasons = [f"{each.lesson.advice}: lesson {each.lesson.id}, {each.because}" for each in used]
        sources = [each.lesson.id for each in used]
        if promoted is not None and strategy.changed.isdisjoint(promoted.strategy.changed):
            strategy = strategy.join(promoted.strategy)
            reasons.append(f"{promoted.strategy}: promoted, {promoted.count} ({promoted.id})")
            sources.append(promoted.id)
        if not used and promoted is None:
            return NOTHING
        return Advice(strategy=strategy, reasons=(*reasons, f"as of {self._memory.version}"), sources=tuple(sources))


def make_scope(session: Session, features: Features, surroundings: Surroundings) -> Scope:
    """The scope of a contract."""
    return Scope(
        scene=session.scene.name,
        skill=session.skill,
        target=session.target,
        object=features.object_kind,
        destination=features.destination_kind,
        body=surroundings.describe_target(session.target),
    )
