"""A task: a goal, the nodes of its graph and how each stands. Its document is TASK.md.

Upstream: goal and node records of the journal, folded by the ledger. Downstream: the mission, which continues from
them, and people. Nodes belong to the agent; the runtime sees sessions only.
"""

from enum import StrEnum

import msgspec

from phyagentos.protocol.documents.document import Document, DocumentFormat, FrontMatter, read_document
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


class Replan(msgspec.Struct, frozen=True, kw_only=True):
    """Why a session of a node was followed by a child.

    Attributes:
        session: The session that did not meet its objective.
        child: The session that revises it.
        reason: What went wrong, and what is done differently.
    """

    session: SessionId
    child: SessionId
    reason: str


class NodeStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A node as it stands.

    Attributes:
        state: See `NodeState`.
        after: Nodes that come first.
        sessions: Its sessions, oldest first; all but the first are children.
        objective: What a person would say.
        skill: As compiled.
        target: As compiled.
        reasons: Why this skill and this target, where the graph left the choice open.
        replans: One for each child, oldest first.
        reason: Why it stands where it does.
    """

    state: NodeState = NodeState.WAITING
    after: tuple[str, ...] = ()
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
        objective: What a person would say.
        asked_by: Who submitted it.
        nodes: By name, in the order of the graph.
        accept: Predicates that decide the goal.
        constraints: Predicates that must hold all through every session.
        replans: Budget spent so far.
        verdict: `success` or `failure`, `unverified` when verification is off; empty before the end.
        criteria: What the verdict rests on; the evidence is a path relative to the workspace.
        reason: Why the verdict fell, or the goal was cancelled.
        is_cancelled: Whether an end was requested.
        submitted_at: UTC wall time.
        updated_at: Wall time of the latest record, UTC.
    """

    id: GoalId
    graph: str = ""
    seed: int = 0
    objective: str = ""
    asked_by: str = ""
    nodes: dict[str, NodeStatus] = {}
    accept: tuple[str, ...] = ()
    constraints: tuple[str, ...] = ()
    replans: int = 0
    verdict: str = ""
    criteria: tuple[Criterion, ...] = ()
    reason: str = ""
    is_cancelled: bool = False
    submitted_at: str = ""
    updated_at: str = ""


TASK = DocumentFormat(
    name="task",
    file="TASK.md",
    says="The goals of a workspace: what was asked, how each node of the graph stands, and why the verdict fell.",
    block=GoalStatus,
    key="id",
    front=FrontMatter,
)


def read_tasks(text: str, source: str = "") -> Document[GoalStatus]:
    """Read TASK.md: goals by id, newest first.

    Raises:
        DefinitionError: With every problem, each at file:line:column.
    """
    return read_document(text, TASK, source)
