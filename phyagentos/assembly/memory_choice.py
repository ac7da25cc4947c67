"""Which memory a run has: that of its project, its workspace's own, a named folder's, or none."""

from dataclasses import dataclass
from pathlib import Path

import yaml

from phyagentos.assembly.project import find_project
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.settings.runtime_contract import read_runtime_contract
from phyagentos.protocol.workspace.workspace import Workspace

NONE, PROJECT, OWN = "none", "project", "workspace"


@dataclass(frozen=True, slots=True)
class ChosenMemory:
    """A memory, and why it is this one; its folder holds `memory/` and `.cache/`, None where nothing is remembered."""

    folder: Path | None
    because: str

    def __str__(self) -> str:
        """`/home/me/kitchen: the project's`."""
        return f"{self.folder or NONE}: {self.because}"


def choose_memory(workspace: Workspace, graph: Path, asked: str | None = None) -> ChosenMemory:
    """The memory of a workspace, kept in memory.yaml, so that who continues it has the same one.

    What is `asked` comes first (`none`, `project`, `workspace` or a folder), then what the workspace began with, then
    records of its own, then runtime_contract.yaml; the project is that of the graph, or else of the working directory.
    Raises DefinitionError with every problem of runtime_contract.yaml.
    """
    begun = read_choice(workspace)
    if asked is None and begun is not None:
        return begun
    if asked is None and workspace.memory.is_dir():
        return ChosenMemory(workspace.root, "the workspace's own records")
    wanted = asked or read_runtime_contract(workspace.runtime_contract).memory
    chosen = _choose(wanted, workspace, graph, "as asked" if asked else "as runtime_contract.yaml says", asked is None)
    kept = {"folder": str(chosen.folder) if chosen.folder else None}
    publish(workspace.memory_place, f"# The memory of this workspace; null for none.\n{yaml.safe_dump(kept)}")
    return chosen


def read_choice(workspace: Workspace) -> ChosenMemory | None:
    """The memory that a workspace began with; None before its first run, or where memory.yaml is unreadable."""
    try:
        data = yaml.safe_load(workspace.memory_place.read_text(encoding="utf-8"))
        folder = data["folder"]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, TypeError, KeyError):
        return None
    return ChosenMemory(Path(folder) if folder else None, "as this workspace began")


def find_memory_project(graph: Path, *folders: Path) -> Path | None:
    """The project that a graph belongs to: a folder with `goal_graphs/`; what ships belongs to no project.

    The folder of the graph comes first, then those named, as a rule the working directory.
    """
    found = (each.resolve() for each in (find_project(graph), *folders) if (each / "goal_graphs").is_dir())
    return next((each for each in found if each != find_shipped_root().resolve()), None)


def _choose(wanted: str, workspace: Workspace, graph: Path, why: str, is_setting: bool) -> ChosenMemory:
    if wanted == NONE:
        return ChosenMemory(None, why)
    if wanted == OWN:
        return ChosenMemory(workspace.root, f"the workspace's own, {why}")
    if wanted == PROJECT and (project := find_memory_project(graph, Path.cwd())) is not None:
        return ChosenMemory(project, "the project's, shared by its runs")
    if wanted == PROJECT:
        return ChosenMemory(workspace.root, "the workspace's own: no folder with goal_graphs/ makes this a project")
    base = workspace.root if is_setting else Path.cwd()
    return ChosenMemory((base / Path(wanted).expanduser()).resolve(), why)
