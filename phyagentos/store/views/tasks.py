"""TASK.md: the goals of a workspace, the graph of each (Mermaid) with the state of its nodes, and its verdict."""

from phyagentos.protocol.documents.document import FrontMatter
from phyagentos.protocol.documents.flowchart import Arrow, Box, render_flowchart
from phyagentos.protocol.documents.markdown import (
    flatten,
    format_moment,
    render_block,
    render_front,
    render_link,
    render_table,
)
from phyagentos.protocol.sessions import tasks
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.store.ledger import Ledger
from phyagentos.store.views.sessions import END_MARK, render_criteria

GOALS_SHOWN = 20  # that have their verdict; the others are all shown
NODES_DRAWN = 150  # more than a person can follow, and close to what a forge still draws
EDGES_DRAWN = 400  # Mermaid draws 500
ADVISED_SHOWN = 20  # sessions of a goal that memory changed; the others are counted

_HEAD = """# Tasks

The goals of this workspace, newest first: what was asked, how each node of the graph stands, and why it was judged so.

- **Written by** the agent, from the goal and node records of the journal in `sessions/`, which is the truth.
- **An edit amends an open goal**: of its YAML, nodes that have not begun may be taken out, `after`, `accept` and
  `constraints` changed. Anything else of its graph changes with `paos amend`; `paos cancel` ends a goal.
- **A node** becomes a session only when it is ready; the runtime never sees the graph. What each session did is in
  `SESSIONS.md`, what it saw in its folder under `evidence/`. The graph as submitted is `goals/<goal id>.yaml`.

"""
_NOTHING = "No goal has been submitted yet.\n"
_COLORS = {
    tasks.NodeState.WAITING: "fill:#eceff1,stroke:#90a4ae,color:#263238",
    tasks.NodeState.READY: "fill:#e3f2fd,stroke:#1e88e5,color:#0d47a1",
    tasks.NodeState.ACTIVE: "fill:#fff3e0,stroke:#fb8c00,color:#bf360c",
    tasks.NodeState.DONE: "fill:#e8f5e9,stroke:#43a047,color:#1b5e20",
    tasks.NodeState.BLOCKED: "fill:#ffebee,stroke:#e53935,color:#b71c1c",
    tasks.NodeState.INVALIDATED: "fill:#f3e5f5,stroke:#8e24aa,color:#4a148c",
    tasks.NodeState.SKIPPED: "fill:#fafafa,stroke:#b0bec5,color:#78909c",
    tasks.NodeState.RESCUED: "fill:#f9fbe7,stroke:#9e9d24,color:#827717",
    tasks.PAST: "fill:#ffffff,stroke:#90a4ae,color:#546e7a",
}


def render_tasks(ledger: Ledger) -> str:
    """TASK.md."""
    shown, older = select_goals(ledger)
    sections = [render_task(goal, ledger) for goal in shown]
    note = f"{older} older goals are not shown; their records are in `sessions/`, their graphs in `goals/`.\n"
    front = render_front(FrontMatter(phy=tasks.TASK.phy, view=ledger.seq))
    return f"{front}{_HEAD}{''.join(sections) or _NOTHING}{note if older else ''}{END_MARK}"


def select_goals(ledger: Ledger) -> tuple[list[tasks.GoalStatus], int]:
    """The goals that are shown, newest first, and how many are not: only of the judged ones the oldest are left out."""
    shown = []
    judged = 0
    for goal in reversed(ledger.goals.values()):
        judged += is_over(goal)
        if not is_over(goal) or judged <= GOALS_SHOWN:
            shown.append(goal)
    return shown, max(0, ledger.goal_count - len(shown))


def is_over(goal: tasks.GoalStatus) -> bool:
    """Whether nothing more happens to it."""
    return bool(goal.verdict) or goal.is_cancelled


def render_task(goal: tasks.GoalStatus, ledger: Ledger) -> str:
    """One `## <goal id>` section: what was asked, how it went, graph, nodes, replans, criteria, then all as YAML."""
    by = f" by {goal.asked_by}" if goal.asked_by else ""
    lines = [
        f"**Asked:** {goal.objective or goal.graph} (graph `{goal.graph}`, seed {goal.seed},"
        f" submitted{by}, {format_moment(goal.submitted_at)})",
        f"**Verdict:** {_describe_verdict(goal)}",
        f"**Sessions:** {sum(len(node.sessions) for node in goal.nodes.values())}, replans: {goal.replans}",
    ]
    named = (("Accepted when", goal.accept), ("All through", goal.constraints))
    lines += [f"**{name}:** {', '.join(f'`{each}`' for each in texts)}" for name, texts in named if texts]
    lines += [f"**Changed:** {why}" for why in goal.changes]
    lines += _format_advice(goal, ledger)
    parts = [f"## {goal.id}\n", "".join(f"- {flatten(line)}\n" for line in lines)]
    if goal.nodes:
        parts += [_draw(goal), _render_nodes(goal, ledger)]
    if any(node.replans for node in goal.nodes.values()):
        parts.append("**Replans:**\n")
        parts.append(_render_replans(goal, ledger))
    if goal.criteria:
        parts += ["**Why the goal has this verdict:**\n", render_criteria(goal.criteria, ".").rstrip("\n") + "\n"]
    parts.append(render_block(goal))
    return "\n".join(parts) + "\n"


def render_graph(goal: tasks.GoalStatus) -> str:
    """The goal's graph as a Mermaid flowchart, further attempts included, coloured by state; every label is quoted."""
    boxes = [Box(name=s.name, title=s.name, below=[s.state], kind=s.state) for s in tasks.iter_steps(goal)]
    arrows = [
        Arrow(each.before, each.step, "" if each.relation is tasks.Relation.AFTER else each.relation)
        for each in tasks.iter_edges(goal)
    ]
    return render_flowchart(boxes, arrows, styles=_COLORS)


def _draw(goal: tasks.GoalStatus) -> str:
    steps, edges = sum(1 for _ in tasks.iter_steps(goal)), sum(1 for _ in tasks.iter_edges(goal))
    if steps > NODES_DRAWN or edges > EDGES_DRAWN:
        return f"The graph has {steps} nodes and {edges} edges, too many to draw; the table has them all.\n"
    return f"```mermaid\n{render_graph(goal)}```\n"


def _render_nodes(goal: tasks.GoalStatus, ledger: Ledger) -> str:
    rows = (
        (
            name,
            node.state.value,
            node.objective,
            f"{node.skill} on {node.target}" if node.target else node.skill,
            ", ".join((*node.after, *(f"{' or '.join(edge)} on failure" for edge in node.on_failure))),
            ", ".join(_describe_session(ledger, id) for id in node.sessions),
            "; ".join((node.reason, *node.reasons)) if node.reason else "; ".join(node.reasons),
        )
        for name, node in goal.nodes.items()
    )
    return render_table(("node", "state", "what", "by", "after", "sessions", "why"), rows)


def _render_replans(goal: tasks.GoalStatus, ledger: Ledger) -> str:
    rows = (
        (_link(ledger, each.session), _link(ledger, each.child), describe_fault(each, ledger), each.reason)
        for node in goal.nodes.values()
        for each in node.replans
    )
    return render_table(("session", "revised as", "what went wrong", "what is done differently"), rows)


def describe_fault(replan: tasks.Replan, ledger: Ledger) -> str:
    """Why the parent of a session was revised: the cause and reason of its verdict, or why it was rejected."""
    parent = ledger.sessions.get(replan.session)
    if parent is None:
        return ""
    attempt = parent.decision
    return f"{attempt.cause}: {attempt.reason}" if attempt is not None and attempt.cause else parent.reason


def _describe_verdict(goal: tasks.GoalStatus) -> str:
    if not goal.verdict:
        return f"cancelled, {goal.reason or 'no reason given'}" if goal.is_cancelled else "none yet"
    why = f": {goal.reason}" if goal.reason else ""
    return f"**{goal.verdict}**, {format_moment(goal.updated_at)}{why}"


def _format_advice(goal: tasks.GoalStatus, ledger: Ledger) -> list[str]:
    """One line for each session that memory changed: what it does differently, and the lesson that asked for it."""
    found = (ledger.sessions.get(id) for node in goal.nodes.values() for id in node.sessions)
    advised = [status.contract for status in found if status is not None and status.contract.advice]
    lines = [f"**Memory changed {each.id}:** {'; '.join(each.advice)}" for each in advised[:ADVISED_SHOWN]]
    more = len(advised) - len(lines)
    return [*lines, f"**Memory changed** {more} more sessions; `paos why SESSION` shows how."] if more else lines


def _link(ledger: Ledger, id: SessionId) -> str:
    """The session, linked to its evidence where it left some."""
    status = ledger.sessions.get(id)
    evidence = status.execution.evidence if status is not None and status.execution is not None else ""
    return render_link(evidence, id) if evidence else id


def _describe_session(ledger: Ledger, id: SessionId) -> str:
    """The session and its state; of one that is long over its name only."""
    status = ledger.sessions.get(id)
    return f"{_link(ledger, id)} ({status.state})" if status is not None else id
