"""LESSONS.md: under which conditions a strategy failed, and what helped. Paper section 4.3.

A lesson is advice: it cannot widen a limit. It is born as a hypothesis, and counts only once a verdict shows that its
correction helps.
"""

from collections.abc import Iterable

from phyagentos.protocol.documents.document import DocumentFormat, Front
from phyagentos.protocol.sessions.means import DEFAULT_MEANS, Means
from phyagentos.protocol.sessions.memory_entries import MemoryEntry, Risk, render_entries
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy


class Lesson(MemoryEntry, frozen=True, kw_only=True, omit_defaults=True):
    """One lesson.

    Attributes:
        objective: What was wanted and not reached.
        cause: The coded cause that it is about (`GRASP_LOST`).
        advice: What the skill does differently.
        means: What is done by other means: skill, target, parameters, what comes first.
        verified_by: The latest session in which a verdict showed that it helps; empty for a hypothesis.
        baseline: How often the same succeeds without it.
        risk: Of a session in its scope: `high` for a safety event.
        condition: That was to hold all through and did not, of such an event.
    """

    objective: str = ""
    cause: str = ""
    advice: Strategy = DEFAULT_STRATEGY
    means: Means = DEFAULT_MEANS
    verified_by: str = ""
    baseline: str = ""
    risk: Risk = Risk.NORMAL
    condition: str = ""


LESSONS = DocumentFormat(
    name="lessons",
    file="LESSONS.md",
    summary="What verified outcomes taught: under which conditions a strategy failed, and what helped.",
    block=Lesson,
    key="id",
)
_HEAD = """# Lessons

What verified outcomes taught: under which conditions a strategy failed, and what helped. One section a lesson.

- **Written by** the agent, from the records of memory, at the end of a goal; at most 500, the most useful first.
- **Only `state: active` is ever used**: then a session with this correction was judged a success after one without it
  had failed (`verified_by`). A hypothesis waits for its verdict.
- **A safety event is a lesson at once** (`risk: high`): it is a fact, and advises nothing by itself.
- **An edit is taken in** at the end of the next goal: `state: retracted` with a `reason`, `note`, and the words of
  `scope`. A section that is missing means nothing. `paos memory why ID` shows where a lesson comes from.
- **A lesson is advice.** It cannot widen a limit: limits are in `safety.yaml` only.

"""


def render_lessons(lessons: Iterable[Lesson]) -> str:
    """LESSONS.md."""
    return render_entries(Front(phy=LESSONS.phy), _HEAD, lessons, "No lesson has been recorded yet.\n")
