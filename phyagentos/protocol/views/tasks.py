"""TASK.md: the goals of a workspace, the graph of each with the state of its nodes, and why its verdict fell.

Upstream: the fold. Downstream: people; the graph is Mermaid, which every forge draws.
"""

import msgspec

from phyagentos.protocol.markdown import escape_label, render_criteria, render_table
from phyagentos.protocol.sessions import SessionId
from phyagentos.protocol.store.bodies import render_yaml
from phyagentos.protocol.store.ledger import GoalStatus, Ledger, NodeState

_HEAD = """# Tasks

The goals of this workspace, newest first, and the nodes of their graphs. A view of the journal; each graph as it was
submitted stands in `goals/<goal id>.yaml`.

"""
_COLORS = {
    NodeState.WAITING: "fill:#eceff1,stroke:#90a4ae,color:#263238",
    NodeState.READY: "fill:#e3f2fd,stroke:#1e88e5,color:#0d47a1",
    NodeState.ACTIVE: "fill:#fff3e0,stroke:#fb8c00,color:#bf360c",
    NodeState.DONE: "fill:#e8f5e9,stroke:#43a047,color:#1b5e20",
    NodeState.BLOCKED: "fill:#ffebee,stroke:#e53935,color:#b71c1c",
    NodeState.INVALIDATED: "fill:#f3e5f5,stroke:#8e24aa,color:#4a148c",
}


def render_tasks(ledger: Ledger) -> str:
    """TASK.md."""
    sections = [render_task(goal, ledger) for goal in reversed(ledger.goals.values())]
    return f"---\nview: {ledger.seq}\n---\n\n{_HEAD}" + ("".join(sections) or "No goal has been submitted yet.\n")


def render_task(goal: GoalStatus, ledger: Ledger) -> str:
    """One `## <goal id>` section: what was asked, how it went, the graph, the nodes, the criteria, then all as YAML."""
    lines = [f"**Asked:** {goal.objective or goal.graph} (graph `{goal.graph}`, seed {goal.seed}, {goal.submitted_at})"]
    lines.append(f"**Verdict:** {_describe_verdict(goal)}")
    if goal.replans:
        lines.append(f"**Replans:** {goal.replans}")
    for name, predicates in (("Accepted when", goal.accept), ("All through", goal.constraints)):
        if predicates:
            lines.append(f"**{name}:** {', '.join(f'`{each}`' for each in predicates)}")
    rows = (
        (
            name,
            node.state.value,
            node.objective or node.skill,
            ", ".join(node.after),
            ", ".join(f"{id} ({_get_session_state(ledger, id)})" for id in node.sessions),
            node.reason,
        )
        for name, node in goal.nodes.items()
    )
    told = "\n".join(f"- {line}" for line in lines)
    graph = f"```mermaid\n{render_graph(goal)}```\n\n" if goal.nodes else ""
    table = render_table(("node", "state", "what", "after", "sessions", "why"), rows) + "\n" if goal.nodes else ""
    data = render_yaml(msgspec.to_builtins(goal))
    return f"## {goal.id}\n\n{told}\n\n{graph}{table}{render_criteria(goal.criteria)}```yaml\n{data}```\n\n"


def render_graph(goal: GoalStatus) -> str:
    """The goal's nodes as a Mermaid flowchart, coloured by state; every label is quoted."""
    names = {name: f"n{index}" for index, name in enumerate(goal.nodes)}
    lines = ["flowchart TD"]
    for name, node in goal.nodes.items():
        children = len(node.sessions) - 1
        revised = f"<br/>{children} revised" if children > 0 else ""
        label = f"<b>{escape_label(name)}</b><br/>{node.state.value}{revised}"
        lines.append(f'    {names[name]}["{label}"]:::{node.state.value}')
    for name, node in goal.nodes.items():
        lines += [f"    {names[before]} --> {names[name]}" for before in node.after if before in names]
    lines += [f"    classDef {state.value} {color}" for state, color in _COLORS.items()]
    return "\n".join(lines) + "\n"


def _describe_verdict(goal: GoalStatus) -> str:
    if not goal.verdict:
        return f"cancelled, {goal.reason or 'no reason given'}" if goal.is_cancelled else "none yet"
    return f"{goal.verdict}, {goal.updated_at}" + (f": {goal.reason}" if goal.reason else "")


def _get_session_state(ledger: Ledger, id: SessionId) -> str:
    status = ledger.sessions.get(id)
    return status.state if status is not None else "unknown"
