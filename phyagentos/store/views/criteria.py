"""Judged criteria as a table, for the views that show a verdict."""

from collections.abc import Sequence
from pathlib import PurePosixPath

from phyagentos.protocol.documents.markdown import format_value, render_link, render_table
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.truth import Truth

_MARKS = {Truth.TRUE: "yes", Truth.FALSE: "**no**", Truth.UNKNOWN: "*unknown*"}


def render_criteria(criteria: Sequence[Criterion], folder: str = "") -> str:
    """Judged criteria, one row each; empty without any. Evidence links into the bundle `folder`, if given."""
    if not criteria:
        return ""
    rows = (
        (
            f"`{each.text}`",
            each.kind,
            _MARKS[each.truth],
            each.because,
            ", ".join(f"{name} = {format_value(value)}" for name, value in each.measured.items()),
            render_link(str(PurePosixPath(folder) / each.evidence), each.evidence)
            if folder and each.evidence
            else each.evidence,
        )
        for each in criteria
    )
    return render_table(("criterion", "kind", "holds", "because", "measured", "evidence"), rows) + "\n"
