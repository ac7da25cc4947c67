"""The Python of skills and predicates in a workspace's own copies, where it is not what the project of the user holds.

Workers execute it. A workspace from elsewhere must not run code that its user never saw, so it is named first.
Rejected: a mark of trust in the workspace, which could come with it.
"""

import filecmp
from pathlib import Path

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace


def find_foreign_python(workspace: Workspace, known: Library) -> list[Path]:
    """Each `behaviours.py` of the copies whose skill folder holds a file unlike that in every known library.

    And each file of predicates that none of these holds. Libraries inside the workspace do not count as known.
    """
    roots = _list_roots(workspace, known)
    leaves = [
        path
        for path in workspace.library().iter_behaviours()
        if not any(_is_part_of(path.parent, root / "skills" / path.parent.name) for root in roots)
    ]
    return [*leaves, *find_foreign_predicates(workspace, known)]


def find_foreign_predicates(workspace: Workspace, known: Library) -> list[Path]:
    """Each file of predicates of the copies that no known library holds; the agent executes these alone."""
    roots = _list_roots(workspace, known)
    known_bytes = [path.read_bytes() for root in roots for path in Library((root,)).iter_predicates()]
    return [path for path in workspace.library().iter_predicates() if path.read_bytes() not in known_bytes]


def _list_roots(workspace: Workspace, known: Library) -> list[Path]:
    return [root for root in known.roots if not root.is_relative_to(workspace.root)]


def _is_part_of(folder: Path, other: Path) -> bool:
    """Whether each file of a folder stands in the other one with the same bytes; what it may import is among them."""
    files = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    return not any(filecmp.cmpfiles(folder, other, map(str, files), shallow=False)[1:])
