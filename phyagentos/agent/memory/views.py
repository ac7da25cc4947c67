"""LESSONS.md and KNOWLEDGE.md of a memory: bounded, the most useful first.

Upstream: experience. Downstream: the episode recorder, which publishes them; `paos memory show`.
"""

from phyagentos.agent.memory import methodological, semantic
from phyagentos.agent.memory.experience import Experience
from phyagentos.protocol.sessions.knowledge import Fact
from phyagentos.protocol.sessions.lessons import Lesson
from phyagentos.protocol.sessions.memory_entries import Standing

ENTRIES_MAX = 500  # of either document; a longer one is not read
_ORDER = {Standing.ACTIVE: 0, Standing.RETRACTED: 1, Standing.HYPOTHESIS: 2, Standing.EXPIRED: 3}


def list_lessons(experience: Experience) -> list[Lesson]:
    """At most 500: those in force by how sure they are, then what people retracted, then hypotheses."""
    lessons = [
        methodological.describe(each, experience.find_baseline(each), experience.seq)
        for each in experience.corrections.values()
    ]
    lessons.sort(key=lambda lesson: (_ORDER[lesson.state], -lesson.confidence, -lesson.supported, lesson.id))
    return lessons[:ENTRIES_MAX]


def list_facts(experience: Experience) -> list[Fact]:
    """At most 500: what people added, then what was counted most often."""
    counted = sorted(experience.patterns.values(), key=lambda each: (-each.count.trials, each.id))
    facts = sorted(experience.facts.values(), key=lambda fact: fact.id)
    return [*facts, *map(semantic.describe, counted)][:ENTRIES_MAX]
