"""The statechart of a session as SVG: where it stands, and where it has been."""

from collections.abc import Sequence

from phyagentos.pictures.layers import draw_layers
from phyagentos.protocol.documents.flowchart import Arrow, Box
from phyagentos.protocol.sessions.lifecycle import SESSION_TRANSITIONS, SessionState

MAIN = (  # above all others, in this order
    SessionState.PENDING, SessionState.CLAIMED, SessionState.PREFLIGHT, SessionState.RUNNING, SessionState.HALTING,
    SessionState.CANCELLING, SessionState.OUTCOME_UNKNOWN, SessionState.AWAITING_VERIFICATION, SessionState.VERIFYING,
)  # fmt: skip


def draw_statechart(visited: Sequence[str] = ()) -> str:
    """SVG of the whole table; `visited` are the states that a session has been in, the present one last."""
    order = [*MAIN, *(state for state in SessionState if state not in MAIN)]
    hints: dict[SessionState, list[str]] = {state: [] for state in order}
    for row in SESSION_TRANSITIONS:
        for source in row.sources:
            hints[SessionState(source)].append(f"{row.trigger} → {row.dest} ({', '.join(row.by)})")
    boxes = [
        Box(
            name=state,
            title=state.replace("_", " "),
            kind="here" if [state] == [*visited[-1:]] else "been" if state in visited else "",
            hint="\n".join(hints[state]) or "final",
        )
        for state in order
    ]
    pairs = {(str(source), str(row.dest)) for row in SESSION_TRANSITIONS for source in row.sources}
    arrows = [Arrow(source, dest) for source, dest in sorted(pairs) if source != dest]
    where = f"; it stands at {visited[-1]}" if visited else ""
    return draw_layers(boxes, arrows, f"Statechart of a session{where}")
