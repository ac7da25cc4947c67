"""Reading what happened in a workspace, without changing anything but its cache."""

from pathlib import Path

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.follower import Follower
from phyagentos.store.journal import choose_lane
from phyagentos.store.ledger import Ledger
from phyagentos.store.segments import list_all_segments


def read_ledger(root: Path, about: str = "") -> Ledger:
    """The state of every session and goal; for `about`, a whole session id, only of it and what belongs to it.

    Raises:
        DefinitionError: When the folder is no workspace.
        ExecutionError: `JOURNAL_DAMAGED`.
    """
    workspace = Workspace.open(root)
    folder = workspace.sessions / choose_lane(workspace.sessions)
    if not folder.is_dir():
        return Ledger(forgets=False)
    if about and len(list_all_segments(folder)) > 1:
        found = _find_around(folder, about)
        if found is not None:
            return found
    ledger = Ledger(forgets=False)
    follower = Follower(folder)
    try:
        for record in follower.read_new():
            ledger.apply(record)
    finally:
        follower.close()
    return ledger


def _find_around(folder: Path, id: str) -> Ledger | None:
    from phyagentos.store.history import Histories

    try:
        with Histories(folder) as histories:
            return histories.fold_around(SessionId(id))
    except ExecutionError as error:
        if error.code == "INDEX_UNAVAILABLE":  # a folder that may not be written, say
            return None
        raise
