"""Paths that only the assembly knows, and how a workspace is opened."""

import hashlib
import itertools
import os
import tempfile
from pathlib import Path

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace

FAULTS = Path(".world") / "faults.yaml"  # read by the world process only
TOKENS = Path(".world") / "tokens"  # one file a remote target, which only its owner may read
RECORDED_FAULTS = Path(".world") / "strikes.json"  # of a repeated session: the faults of its evidence


def open_project(root: Path, *projects: Path) -> Workspace:
    """The workspace at `root`, made from the given project folders and what ships, when it does not stand yet."""
    return Workspace.create(root, Library.open(*projects, Path.cwd()))


def find_project(graph: Path) -> Path:
    """The project folder that a goal graph belongs to: the parent of its `goal_graphs/`, else its own folder."""
    folder = graph.resolve().parent
    return folder.parent if folder.name == "goal_graphs" else folder


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
    return folder
