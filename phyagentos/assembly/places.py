"""Where things lie that only the assembly knows, and how a workspace comes to stand."""

from pathlib import Path

from phyagentos.protocol.library import Library
from phyagentos.protocol.workspace import Workspace

FAULTS = Path(".world") / "faults.yaml"  # read by the world process only
STRIKES = Path(".world") / "strikes.json"  # of a repeated session: what struck, as its evidence tells


def open_project(root: Path, *projects: Path) -> Workspace:
    """The workspace at `root`, made from the given project folders and what ships, when it does not stand yet."""
    return Workspace.create(root, Library.open(*projects, Path.cwd()))


def find_project(graph: Path) -> Path:
    """The project folder that a goal graph belongs to: the parent of its `goal_graphs/`, else its own folder."""
    folder = graph.resolve().parent
    return folder.parent if folder.name == "goal_graphs" else folder
