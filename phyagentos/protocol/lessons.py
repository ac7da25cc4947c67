"""Lessons: under which conditions a strategy failed, and what helped. Their document is LESSONS.md.

Upstream: verdicts and their evidence. Downstream: whoever plans next. A lesson is advice: it cannot widen a limit.
"""

from collections.abc import Iterable
from typing import Any

from phyagentos.protocol.document import Document, DocumentFormat, Front, read_document
from phyagentos.protocol.markdown import render_entries
from phyagentos.protocol.memory_entries import MemoryEntry


class Lesson(MemoryEntry, frozen=True, kw_only=True, omit_defaults=True):
    """One lesson.

    Attributes:
        cause: The coded cause that it is about (`GRASP_LOST`).
        advice: What to do differently, as keys of a contract's `strategy`.
    """

    cause: str = ""
    advice: dict[str, Any] = {}


LESSONS = DocumentFormat(
    name="lessons",
    file="LESSONS.md",
    says="What verified outcomes taught: under which conditions a strategy failed, and what helped.",
    block=Lesson,
    key="id",
)
_HEAD = """# Lessons

What verified outcomes taught: under which conditions a strategy failed, and what helped. One section a lesson.

- **Written by** people, for now: nothing in this version derives lessons from verdicts, and no planner reads them yet.
- **An edit stands.** `paos lint LESSONS.md` checks it. Retract a lesson with `state: retracted` and a `reason`; do not
  delete it.
- **A lesson is advice.** It cannot widen a limit: limits are in `safety.yaml` only.

"""


def render_lessons(lessons: Iterable[Lesson]) -> str:
    """LESSONS.md."""
    return render_entries(Front(phy=LESSONS.phy), _HEAD, lessons, "No lesson has been recorded yet.\n")


def read_lessons(text: str, source: str = "") -> Document[Lesson]:
    """Read LESSONS.md: lessons by id.

    Raises:
        DefinitionError: With every problem, each at file:line:column.
    """
    return read_document(text, LESSONS, source)
