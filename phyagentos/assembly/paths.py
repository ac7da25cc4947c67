"""Paths that only the assembly knows, and how a workspace is opened."""

import contextlib
import itertools
import os
import shutil
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.enclosure import SOCKETS
from phyagentos.protocol.documents.leftovers import sweep_leftovers
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, become_sole
from phyagentos.protocol.workspace.workspace import Workspace

FAULTS = Path(".world") / "faults.yaml"  # read by the world process only
OUTCOMES = Path(".world") / "outcomes.jsonl"  # what environments say of success, for who measures; no agent reads it
TOKENS = Path(".world") / "tokens"  # one file a remote target, which only its owner may read
RECORDED_FAULTS = Path(".world") / "strikes.json"  # of a repeated session: the faults of its evidence


def open_project(root: Path, *projects: Path) -> Workspace:
    """The workspace at `root`, made from the given project folders and what ships, when it does not stand yet."""
    return Workspace.create(root, Library.open(*projects, Path.cwd()))


@contextlib.contextmanager
def serve_alone(workspace: Workspace, clock: Clock) -> Iterator[None]:
    """While the block runs, no other `paos run` or `paos watch` serves this workspace; raises `BUSY`.

    What killed processes have left is swept first.
    """
    try:
        lock = become_sole(workspace.root / RUNTIME_LOCK, clock, "BUSY", "another one", patience_s=0.0)
    except ExecutionError as error:
        found = str(error).partition(": ")[2]
        expected = "one `paos run` or `paos watch` in a workspace"
        hint = f"To give that one another goal: paos agent GRAPH -w {workspace.root}. Or name another workspace."
        raise DefinitionError.of("BUSY", str(workspace.root), found, expected, hint) from error
    try:
        sweep_leftovers(workspace.root, datetime.fromisoformat(clock.wall_iso()).timestamp())
        yield
    finally:
        os.close(lock)


def choose_folder(parent: Path, name: str) -> Path:
    """`<parent>/<name>-<n>`, the first that does not exist."""
    return next(path for number in itertools.count(1) if not (path := parent / f"{name}-{number}").exists())


def make_socket_folder(root: Path) -> Path:
    """The folder of a workspace's sockets, for this user alone; in the workspace, where no cleaner of TMPDIR comes."""
    folder = root / SOCKETS
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise ExecutionError("NOT_SECURED", f"{folder} can be used by others; remove it")
    folder.chmod(0o700)
    return folder


def remove_socket_folders(ended: Path) -> None:
    """Remove the socket folder of a workspace that is served no longer; that of no other is known here."""
    shutil.rmtree(ended / SOCKETS, ignore_errors=True)
