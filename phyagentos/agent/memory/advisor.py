"""The advisor: what verified experience advises for a session before it is submitted. Paper section 4.3 (retrieval).

Only the first attempt of a node is advised: a repair rests on fresher evidence. A copy of what was recalled for a
session stays in its workspace, whatever becomes of the memory. Look-ahead (`repair.foreseen`) proposes in
the same form.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import msgspec

from phyagentos.agent.memory.cautions import Caution
from phyagentos.agent.memory.episodes import Features, Surroundings
from phyagentos.agent.memory.memory import Found, Memory, Retrieval
from phyagentos.agent.memory.methodological import join_ways
from phyagentos.agent.memory.semantic import Pattern
from phyagentos.protocol.capabilities.skill_runtimes import ParameterRole, find_parameter
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.means import DEFAULT_MEANS, Means
from phyagentos.protocol.sessions.memory_entries import MemoryEntry, Risk, Scope
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """Changes of a contract that experience or look-ahead proposes.

    Attributes:
        threshold: Of the child's look-ahead; None for that of its node.
        parameters: Of a skill that takes what memory warns of.
        means: Other means, where they can be had in the present world.
        otherwise: The advice where they cannot.
    """

    strategy: Strategy = DEFAULT_STRATEGY
    means: Means = DEFAULT_MEANS
    otherwise: "Advice | None" = None
    reasons: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    threshold: float | None = None
    parameters: Fields = field(default_factory=dict)


class Advisor(Protocol):
    """The port: asked once for the first attempt of every node, before it is submitted."""

    def begin(self, graph: str, snapshot: str) -> str:
        """Advise a goal from one snapshot to its end; the name of that snapshot, empty without a memory.

        `snapshot` is that which it has begun with; empty for a new goal, and the present one.
        """

    def advise(self, session: Session) -> Advice:
        """Advice of experience about a contract, as compiled; where others have prepared it, with a parent."""


class NoAdvice:
    """The advisor without memory."""

    def begin(self, graph: str, snapshot: str) -> str:
        """Nothing."""
        return ""

    def advise(self, session: Session) -> Advice:
        """Nothing."""
        return NOTHING


NOTHING = Advice()


def apply_advice(session: Session, advice: Advice) -> Session:
    """The contract with the advice in it; what a repair has chosen for this session wins over what is remembered."""
    if not (advice.strategy or advice.reasons or advice.parameters):
        return session
    strategy = session.strategy.join(advice.strategy)
    parameters = {**session.parameters, **advice.parameters}
    return msgspec.structs.replace(
        session, strategy=strategy, parameters=parameters, advice=advice.reasons, advised_by=advice.sources
    )


class MemoryAdvisor:
    """Advises from memory; copies of what is recalled go to `<session>.json` in the folder `copies`, if any."""

    def __init__(self, memory: Memory, surroundings: Surroundings, copies: Path | None = None) -> None:
        self._memory, self._surroundings, self._copies = memory, surroundings, copies
        self._known: Retrieval = memory
        self._graph = self._snapshot = ""

    def begin(self, graph: str, snapshot: str) -> str:
        """Advise from the snapshot that a goal has begun with, as far as its records are there."""
        now = self._memory.snapshot
        earlier = self._memory.look_back(snapshot) if snapshot not in {"", now} else None
        self._known = earlier or self._memory
        self._graph, self._snapshot = graph, snapshot if earlier is not None else now
        return self._snapshot

    def advise(self, session: Session) -> Advice:
        """What was verified to help in its scope; nothing where nothing is known."""
        experience = self._known.experience
        if not (experience.corrections or experience.patterns or experience.cautions):
            return NOTHING
        features = self._surroundings.describe(session)
        scope = make_scope(session, features, self._surroundings, self._graph)
        advice, entries = self._find(scope)
        skill = self._surroundings.skills.get(session.skill)
        if skill is not None and (key := find_parameter(skill, ParameterRole.BROKEN)):
            conditions = self._known.list_violated(scope)
            advice = replace(advice, parameters={key: "; ".join(conditions)} if conditions else {})
        if entries and self._copies is not None:
            self._copies.mkdir(exist_ok=True)
            kept = msgspec.json.format(msgspec.json.encode({"snapshot": self._snapshot, "entries": entries}))
            publish(self._copies / f"{session.id}.json", kept.decode())
        return advice

    def _find(self, scope: Scope) -> tuple[Advice, tuple[MemoryEntry, ...]]:
        known = self._known
        found, promoted, warned = known.recall(scope), known.find_promoted(scope), known.warn(scope)
        advice = self._join(found, promoted, warned)
        if advice.means:
            plain = [each for each in found if not each.lesson.means]
            advice = replace(advice, otherwise=self._join(plain, promoted, warned))
        ids = [*(each.lesson.id for each in found), *(each.id for each in warned)]
        ids += [promoted.id] if promoted is not None else []
        return advice, tuple(filter(None, map(known.experience.find, ids)))

    def _join(self, found: Sequence[Found], promoted: Pattern | None, warned: Sequence[Caution]) -> Advice:
        """One advice of several lessons: of two that disagree the better one."""
        strategy, means = DEFAULT_STRATEGY, DEFAULT_MEANS
        used: list[Found] = []
        for each in found:
            lesson = each.lesson
            is_other = bool(lesson.means.skill or lesson.means.target)  # what is known of the own one says nothing then
            is_at_odds = not strategy.changed.isdisjoint(lesson.advice.changed)
            if is_at_odds or (used and is_other) or (means and lesson.means):
                continue
            strategy, means = strategy.join(lesson.advice), lesson.means or means
            used.append(each)
            if is_other:
                break
        lessons = [each.lesson for each in used]
        ways = [join_ways(each.advice, each.means) for each in lessons]
        reasons = [f"{way}: lesson {each.lesson.id}, {each.because}" for way, each in zip(ways, used, strict=True)]
        sources = [each.id for each in lessons]
        if promoted is not None and not means and strategy.changed.isdisjoint(promoted.strategy.changed):
            strategy = strategy.join(promoted.strategy)
            reasons.append(f"{promoted.strategy}: promoted, {promoted.count} ({promoted.id})")
            sources.append(promoted.id)
        reasons += [f"{Risk.HIGH} risk: {each.code} in {each.count} sessions ({each.id})" for each in warned]
        if not reasons:
            return NOTHING
        version = f"as of {self._known.version}"
        return Advice(strategy=strategy, means=means, reasons=(*reasons, version), sources=tuple(sources))


def make_scope(session: Session, features: Features, surroundings: Surroundings, graph: str = "") -> Scope:
    """The case of a contract: its goal, scene, skill, objects, body, and what is at stake."""
    return Scope(
        scene=session.scene.name,
        skill=session.skill,
        target=session.target,
        object=features.object_kind,
        destination=features.destination_kind,
        body=surroundings.describe_target(session.target),
        goal=graph,
        risk=Risk.GUARDED if session.hold else Risk.NORMAL,
    )
