"""Reading what happened in a workspace, without writing a byte into it."""

from pathlib import Path

from phyagentos.protocol.store.follower import Follower
from phyagentos.protocol.store.journal import choose_lane
from phyagentos.protocol.store.ledger import Ledger
from phyagentos.protocol.workspace import Workspace


def read_ledger(root: Path) -> Ledger:
    """The state of every session and goal.

    Raises:
        DefinitionError: When the folder is no workspace.
        ExecutionError: `JOURNAL_DAMAGED`.
    """
    workspace = Workspace.open(root)
    ledger = Ledger()
    folder = workspace.sessions / choose_lane(workspace.sessions)
    if folder.is_dir():
        follower = Follower(folder)
        try:
            for record in follower.read_new():
                ledger.apply(record)
        finally:
            follower.close()
    return ledger
