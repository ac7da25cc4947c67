"""Paths that only the assembly knows, and how a workspace is opened."""

import contextlib
import hashlib
import itertools
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, WATCHDOG_LOCK, become_sole, is_held
from phyagentos.protocol.workspace.workspace import Workspace

FAULTS = Path(".world") / "faults.yaml"  # read by the world process only
OUTCOMES = Path(".world") / "outcomes.jsonl"  # what environments say of success, for who measures; no agent reads it
TOKENS = Path(".world") / "tokens"  # one file a remote target, which only its owner may read
_OWNER = "workspace"  # in a folder of sockets: a link to the workspace they belong to
RECORDED_FAULTS = Path(".world") / "strikes.json"  # of a repeated session: the faults of its evidence


def open_project(root: Path, *projects: Path) -> Workspace:
    """The workspace at `root`, made from the given project folders and what ships, when it does not stand yet."""
    return Workspace.create(root, Library.open(*projects, Path.cwd()))


@contextlib.contextmanager
def serve_alone(workspace: Workspace, clock: Clock) -> Iterator[None]:
    """While the block runs, no other `paos run` or `paos watch` serves this workspace; raises `BUSY`."""
    try:
        lock = become_sole(workspace.root / RUNTIME_LOCK, clock, "BUSY", "another one", patience_s=0.0)
    except ExecutionError as error:
        found = str(error).partition(": ")[2]
        expected = "one `paos run` or `paos watch` in a workspace"
        hint = f"To give that one another goal: paos agent GRAPH -w {workspace.root}. Or name another workspace."
        raise DefinitionError.of("BUSY", str(workspace.root), found, expected, hint) from error
    try:
        yield
    finally:
        os.close(lock)


def choose_folder(parent: Path, name: str) -> Path:
    """`<parent>/<name>-<n>`, the first that does not exist."""
    return next(path for number in itertools.count(1) if not (path := parent / f"{name}-{number}").exists())


def make_socket_folder(root: Path) -> Path:
    """The folder of a workspace's sockets, for this user alone; in TMPDIR, since a UNIX path has at most 107 bytes."""
    ours = Path(tempfile.gettempdir()) / f"paos-{os.getuid()}"
    folder = ours / hashlib.sha256(os.fsencode(root.resolve())).hexdigest()[:16]
    for each in (ours, folder):
        each.mkdir(mode=0o700, exist_ok=True)
        found = each.lstat()
        if found.st_uid != os.getuid() or found.st_mode & 0o077:
            raise ExecutionError("SOCKETS_UNSAFE", f"{each} can be used by others; remove it, or set TMPDIR")
    with contextlib.suppress(FileExistsError):
        (folder / _OWNER).symlink_to(root.resolve())
    return folder


def remove_socket_folders(ended: Path) -> None:
    """Remove the socket folder of a workspace that is served no longer, and those that killed runtimes have left."""
    for folder in sorted((Path(tempfile.gettempdir()) / f"paos-{os.getuid()}").glob("*")):
        with contextlib.suppress(OSError):  # another process removes it, too
            root = (folder / _OWNER).readlink()
            if root == ended.resolve() or not any(
                map(is_held, (root / WATCHDOG_LOCK, *(root / ".world" / "locks").glob("*.lock")))
            ):
                shutil.rmtree(folder, ignore_errors=True)
