"""A task: a goal, the nodes of its graph and how each stands. Its document is TASK.md.

Nodes belong to the agent; the runtime sees sessions only.
"""

from collections.abc import Iterator
from enum import StrEnum

import msgspec

from phyagentos.protocol.documents.document import DocumentFormat, FrontMatter
from phyagentos.protocol.sessions.session import GoalId, SessionId
from phyagentos.protocol.sessions.verdicts import Criterion


class NodeState(StrEnum):
    """Where a node of a goal graph stands."""

    WAITING = "waiting"
    """Something before it is not done."""
    READY = "ready"
    """It may become a session."""
    ACTIVE = "active"
    """A session works on it."""
    DONE = "done"
    """A session succeeded."""
    BLOCKED = "blocked"
    """It cannot be done."""
    INVALIDATED = "invalidated"
    """It was done, and holds no longer."""
    SKIPPED = "skipped"
    """Its branch is not taken: what it waits for did not fail."""
    RESCUED = "rescued"
    """It failed, and the branch on its failure succeeded."""


class Relation(StrEnum):
    """Why one step of a goal comes before another."""

    AFTER = "after"
    """As authored."""
    ON_FAILURE = "on failure"
    """As authored: the step is taken when the other one cannot be done."""
    REPLAN = "replan"
    """The child does differently what its parent did not achieve."""
    CLEARS = "clears"
    """The child moves away what was in the way of its parent."""
    LOOKS = "looks"
    """The child looks for what its parent left unknown."""
    AGAIN = "again"
    """The child achieves again what its parent had achieved."""
    RESTORES = "restores"
    """The next session of a node needs what this one achieves again."""


class Replan(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A session of a node after its first one.

    Attributes:
        session: Its parent.
        child: The session; it may still be to be submitted.
        reason: What is done differently, and why so.
        relation: How it continues its parent.
        after: Nodes that must be done again before it.
    """

    session: SessionId
    child: SessionId
    reason: str
    relation: Relation = Relation.REPLAN
    after: tuple[str, ...] = ()


class NodeStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A node as it stands.

    Attributes:
        state: See `NodeState`.
        after: Nodes that come first.
        on_failure: Edges on failure: of each one the nodes of which at least one must have failed.
        sessions: Its sessions, oldest first.
        objective: In words, for people.
        skill: As compiled.
        target: As compiled.
        reasons: Why this skill and this target, where the graph left the choice open.
        replans: Its sessions after the first, oldest first; the last one may still be to be submitted.
        reason: Why it stands where it does.
    """

    state: NodeState = NodeState.WAITING
    after: tuple[str, ...] = ()
    on_failure: tuple[tuple[str, ...], ...] = ()
    sessions: tuple[SessionId, ...] = ()
    objective: str = ""
    skill: str = ""
    target: str = ""
    reasons: tuple[str, ...] = ()
    replans: tuple[Replan, ...] = ()
    reason: str = ""


class GoalStatus(msgspec.Struct, kw_only=True, omit_defaults=True):
    """A goal as it stands; belongs to the ledger.

    Attributes:
        id: Of the goal.
        graph: Name of the goal graph.
        seed: Root of every random choice of this goal.
        objective: In words, for people.
        asked_by: Who submitted it.
        memory: Snapshot of the memory that advises it; empty for none.
        nodes: By name, in the order of the graph.
        accept: Predicates that decide the goal.
        constraints: Predicates that must hold all through every session.
        replans: Budget spent so far.
        verdict: `success` or `failure`, `unverified` when verification is off; empty before the end.
        criteria: What the verdict rests on; the evidence is a path relative to the workspace.
        reason: Why the goal has its verdict, or the goal was cancelled.
        is_cancelled: Whether an end was requested.
        file: Name of the graph in `goals/` since it was amended; empty while it is as submitted.
        asked: Graphs in `goals/` that a person wants instead, and that the agent has not answered yet.
        changes: Why the graph was changed, or was not where a person had asked for it; the oldest first.
        submitted_at: UTC wall time.
        updated_at: Wall time of the latest record, UTC.
    """

    id: GoalId
    graph: str = ""
    seed: int = 0
    objective: str = ""
    asked_by: str = ""
    memory: str = ""
    nodes: dict[str, NodeStatus] = {}
    accept: tuple[str, ...] = ()
    constraints: tuple[str, ...] = ()
    replans: int = 0
    verdict: str = ""
    criteria: tuple[Criterion, ...] = ()
    reason: str = ""
    is_cancelled: bool = False
    file: str = ""
    asked: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    submitted_at: str = ""
    updated_at: str = ""


class Step(msgspec.Struct, frozen=True, kw_only=True):
    """A vertex of the goal's graph: one attempt at a node.

    Attributes:
        name: The node for its first session, else the id of the session without the goal.
        state: That of the node for its latest attempt, else `past`.
        session: Its id; empty before the node's first one is submitted.
    """

    name: str
    node: str
    state: str
    session: str = ""


class Edge(msgspec.Struct, frozen=True, kw_only=True, order=True):
    """`before` must be over before `step` begins."""

    before: str
    step: str
    relation: Relation


PAST = "past"
_OF_PURPOSE = {"clear": Relation.CLEARS, "inspect": Relation.LOOKS}


def compute_session_id(goal: GoalId, node: str, attempt: int) -> SessionId:
    """Id of a node's session; attempt 0 is the first one."""
    return SessionId(f"{goal}.{node}" + (f".r{attempt}" if attempt else ""))


def get_relation(purpose: str) -> Relation:
    """How a child of that purpose continues its parent."""
    return _OF_PURPOSE.get(purpose, Relation.REPLAN)


def get_step_name(goal: GoalId, session: SessionId) -> str:
    """Name of the step that a session is; a node's first session is the step that is called like the node."""
    return session.removeprefix(f"{goal}.")


def iter_steps(goal: GoalStatus) -> Iterator[Step]:
    """The vertices of a goal's graph, each node followed by its further attempts."""
    for name, node in goal.nodes.items():
        attempts = [name, *(get_step_name(goal.id, each.child) for each in node.replans)]
        ids = [node.sessions[0] if node.sessions else "", *(each.child for each in node.replans)]
        for attempt, id in zip(attempts, ids, strict=True):
            yield Step(name=attempt, node=name, state=node.state if attempt is attempts[-1] else PAST, session=id)


def iter_edges(goal: GoalStatus) -> Iterator[Edge]:
    """The edges between these: what waits for a node waits for its latest attempt."""
    steps = {step.name for step in iter_steps(goal)}
    latest = {
        name: get_step_name(goal.id, node.replans[-1].child) if node.replans else name
        for name, node in goal.nodes.items()
    }
    for name, node in goal.nodes.items():
        found = [(before, name, Relation.AFTER) for before in node.after]
        found += [(before, name, Relation.ON_FAILURE) for edge in node.on_failure for before in edge]
        for each in node.replans:
            step, parent = get_step_name(goal.id, each.child), get_step_name(goal.id, each.session)
            found += [(before, step, Relation.RESTORES) for before in each.after]
            yield Edge(before=parent if parent in steps else name, step=step, relation=each.relation)
        for before, step, relation in found:
            if before in latest:
                yield Edge(before=latest[before], step=step, relation=relation)


TASK = DocumentFormat(
    name="task",
    file="TASK.md",
    summary="The goals of a workspace: what was asked, how each node of the graph stands, and why it was judged so.",
    block=GoalStatus,
    key="id",
    front=FrontMatter,
)
