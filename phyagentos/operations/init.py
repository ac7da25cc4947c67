"""Make a project of one's own: a goal graph, a scene and a skill that run at once."""

import shutil
from pathlib import Path

import msgspec

from phyagentos.protocol.documents.durable_files import require_empty

TEMPLATES = Path(__file__).with_name("scaffold")


class NewProject(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos init --json` prints; `graph` is the one to run first."""

    folder: str
    files: tuple[str, ...]
    graph: str


def init(folder: Path) -> NewProject:
    """Write a project into a folder that is missing or empty; raises `WOULD_OVERWRITE`."""
    require_empty(folder)
    shutil.copytree(TEMPLATES, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__", ".*"))
    files = sorted(str(path) for path in folder.rglob("*") if path.is_file())
    return NewProject(folder=str(folder), files=tuple(files), graph=str(folder / "goal_graphs" / "first.yaml"))
