"""Which workspaces there are, and what stands in the journal of one; changes nothing."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from phyagentos.errors import DefinitionError
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import MARKER, Workspace
from phyagentos.store.history import Histories, fold_partition
from phyagentos.store.journal import choose_partition
from phyagentos.store.ledger import Ledger
from phyagentos.store.segments import list_all_segments
from phyagentos.store.subjects import get_session

FOLDER = Path("workspaces")  # of the working directory: where runs make theirs
REQUESTS = "requests"  # of a workspace: goals that were asked for in words, with their graphs
_WRITTEN = ("sessions/*/*.md", f"{REQUESTS}/*")  # what changes when a workspace is used


def find_workspaces() -> list[Path]:
    """The working directory where it is a workspace, and those in `workspaces/`; what was written last comes first."""
    markers = [path for path in (Path(MARKER), *FOLDER.glob(f"*/{MARKER}")) if path.is_file()]
    written = {each.parent: [each, *(path for kind in _WRITTEN for path in each.parent.glob(kind))] for each in markers}
    return sorted(written, key=lambda root: max(path.stat().st_mtime for path in written[root]), reverse=True)


def get_newest() -> tuple[Path, int]:
    """The workspace that was written last, and of how many; raises `NOT_A_WORKSPACE` where there is none."""
    if found := find_workspaces():
        return found[0], len(found)
    wanted, hint = "a workspace that `paos run` has made there", "Name one: --workspace W; `paos store` takes W alone."
    raise DefinitionError.of("NOT_A_WORKSPACE", str(FOLDER), "none", wanted, hint)


def find_running() -> list[Path]:
    """Every workspace on this machine that a runtime of this user supervises, wherever it is."""
    roots = set()
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):  # the process of another user, or one that ended
            roots.add(Path(str(link.readlink()).removesuffix(f"/{WATCHDOG_LOCK}")))
    return sorted(root for root in roots if (root / MARKER).is_file() and is_held(root / WATCHDOG_LOCK))


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


def find_session(root: Path, name: str) -> tuple[Workspace, SessionStatus]:
    """A session of a workspace, by its id or the part after the goal; raises DefinitionError `UNKNOWN_NAME`."""
    known = read_ledger(root, name).sessions
    return Workspace.open(root), known[get_session(name, known)]
