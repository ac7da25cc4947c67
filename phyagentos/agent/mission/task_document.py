"""TASK.md: rendered by the agent, and edited by people: what they change of an open goal becomes an amendment."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import msgspec

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.sessions.tasks import TASK, GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.ledger import Ledger
from phyagentos.store.shared_file import SharedFile
from phyagentos.store.views.tasks import is_over, render_tasks

RENDERINGS_KEPT = 64  # that an edit may have been made from
_JUDGED = ("accept", "constraints")
_FREE = frozenset({"nodes", *_JUDGED})
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskEdit:
    """What a person changed in the block of one goal; all fields hold only what differs.

    Attributes:
        after: Node -> what comes before it now.
        judged: `accept` and `constraints` as they are now.
        foreign: What is not for people to change here.
    """

    goal: GoalId
    removed: tuple[str, ...] = ()
    after: Mapping[str, tuple[str, ...]]
    judged: Mapping[str, list[str]]
    foreign: tuple[str, ...] = ()


class TaskDocument:
    """TASK.md of one workspace; belongs to one thread."""

    def __init__(self, workspace: Workspace, clock: Clock) -> None:
        self._file = SharedFile(workspace.task, workspace.edits / workspace.task.stem, clock)
        self._file.adopt()
        self._rejected = workspace.task.with_suffix(".rejected.md")
        self._shown: dict[int, dict[GoalId, GoalStatus]] = {}
        self._edits: list[TaskEdit] = []

    def is_touched(self) -> bool:
        """Whether another process wrote it since it was rendered last."""
        return bool(self._shown) and self._file.is_touched()

    def publish(self, ledger: Ledger) -> None:
        """Render the present state."""
        open_goals = {id: goal for id, goal in ledger.goals.items() if not is_over(goal)}
        copies = {id: msgspec.structs.replace(goal, nodes=dict(goal.nodes)) for id, goal in open_goals.items()}
        self._shown[ledger.seq] = copies
        while len(self._shown) > RENDERINGS_KEPT:
            del self._shown[next(iter(self._shown))]
        self._file.put(render_tasks(ledger))

    def take(self, *, at_once: bool = False) -> list[TaskEdit]:
        """What people changed since the last call; `at_once` waits for no editor."""
        self._edits = []
        self._file.take(self._read, at_once=at_once)
        return self._edits

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read(self, data: bytes, _is_whole: bool) -> None:
        text = data.decode(errors="replace")
        try:
            document = read_document(text, TASK)
        except DefinitionError as error:
            self._refuse(text, f"it cannot be read: {error}")
            return
        view = getattr(document.front, "view", -1)
        shown = self._shown.get(view, None if view else {})  # 0 shows no goal, as the pristine document
        if shown is None:
            self._refuse(text, "it was made from a rendering that is not known any more; use `paos amend`")
            return
        for id, goal in shown.items():
            if id in document.blocks and (edit := _compare(goal, document.blocks[id])) is not None:
                self._edits.append(edit)

    def _refuse(self, text: str, reason: str) -> None:
        """Keep refused text word for word beside the document."""
        with self._rejected.open("a", encoding="utf-8") as file:
            file.write(f"{reason}\n\n{text}\n\n")
        _LOG.warning("TASK.md: an edit was not taken in (%s); see %s", reason, self._rejected.name)


def _compare(ours: GoalStatus, theirs: GoalStatus) -> TaskEdit | None:
    """What differs; None where nothing does."""
    both = [(name, ours.nodes[name], node) for name, node in theirs.nodes.items() if name in ours.nodes]
    foreign = [key for key in ours.__struct_fields__ if key not in _FREE and getattr(ours, key) != getattr(theirs, key)]
    foreign += [f"nodes.{name}" for name in theirs.nodes if name not in ours.nodes]
    foreign += [f"nodes.{name}" for name, own, node in both if msgspec.structs.replace(node, after=own.after) != own]
    edit = TaskEdit(
        goal=ours.id,
        removed=tuple(name for name in ours.nodes if name not in theirs.nodes),
        after={name: node.after for name, own, node in both if node.after != own.after},
        judged={key: list(now) for key in _JUDGED if (now := getattr(theirs, key)) != getattr(ours, key)},
        foreign=tuple(foreign),
    )
    return edit if edit.removed or edit.after or edit.judged or edit.foreign else None
