"""SKILLRUNTIME.md: the ways that have proved themselves become part of the entry of their skill.

Upstream: promotion. Downstream: people and readers of the registry. Nothing else of an entry is touched.
"""

from collections.abc import Iterable
from pathlib import Path

import msgspec

from phyagentos.agent.memory.promotion import Rank
from phyagentos.agent.memory.semantic import Pattern
from phyagentos.protocol.capabilities.registries import read_skill_registry, render_skills
from phyagentos.protocol.capabilities.skill_runtimes import PromotedWay
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.sessions.memory_entries import Standing


def renew_promoted(path: Path, patterns: Iterable[Pattern]) -> bool:
    """Write what is promoted now into SKILLRUNTIME.md; whether anything changed.

    Args:
        path: Of the document.
        patterns: All that memory knows.

    Raises:
        DefinitionError: With every problem of the document; it stays as it is.
    """
    ways: dict[str, list[PromotedWay]] = {}
    for each in sorted(patterns, key=lambda pattern: pattern.id):
        if each.trial.rank is Rank.PROMOTED and each.strategy and each.state is Standing.ACTIVE:
            ways.setdefault(each.scope.skill, []).append(_describe(each))
    skills = read_skill_registry(path)
    renewed = []
    for skill in skills.values():
        known = {way.entry: way for way in skill.promoted}
        now = tuple(known.get(way.entry, way) for way in ways.get(skill.skill, ()))  # the rate stays that of the day
        renewed.append(skill.model_copy(update={"promoted": now}))
    if renewed == list(skills.values()):
        return False
    publish(path, render_skills(renewed))
    return True


def _describe(pattern: Pattern) -> PromotedWay:
    scope = pattern.scope
    return PromotedWay(
        entry=pattern.id,
        scene=scope.scene,
        target=scope.target,
        object=scope.object,
        destination=scope.destination,
        strategy=msgspec.to_builtins(pattern.strategy),
        rate=str(pattern.count),
    )
