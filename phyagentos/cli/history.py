"""Reading what happened in a workspace, without changing anything."""

from collections.abc import Sequence
from pathlib import Path

from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.history import Histories, fold_partition
from phyagentos.store.journal import choose_partition
from phyagentos.store.ledger import Ledger
from phyagentos.store.segments import list_all_segments


def read_ledger(root: Path, about: str = "", parts: Sequence[str] = ()) -> Ledger:
    """The state of every session and goal; for `about`, a whole session id, only of it and what belongs to it.

    Raises DefinitionError when the folder is no workspace, ExecutionError `JOURNAL_DAMAGED`.
    """
    workspace = Workspace.open(root, *parts)
    folder = workspace.sessions / choose_partition(workspace.sessions)
    if about and folder.is_dir() and len(list_all_segments(folder)) > 1:
        with Histories(folder) as histories:
            if (found := histories.fold_around(SessionId(about))) is not None:
                return found
    return fold_partition(folder)
