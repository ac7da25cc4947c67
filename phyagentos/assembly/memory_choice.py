"""Which memory a run has: that of its project, its workspace's own, a named folder's, or none."""

from dataclasses import dataclass
from pathlib import Path

import yaml

from phyagentos.assembly.project import find_project
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.documents.regular_files import REQUEST_MAX, read_regular
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
    Files of a workspace from elsewhere lead nowhere outside: see `read_choice`. A folder of runtime_contract.yaml lies
    in the workspace or beside it. Raises DefinitionError with every problem of runtime_contract.yaml; `LEADS_OUT`.
    """
    begun = read_choice(workspace, graph)
    if asked is None and begun is not None:
        return begun
    if asked is None and workspace.memory.is_dir():
        return ChosenMemory(workspace.root, "the workspace's own records")
    wanted = asked or read_runtime_contract(workspace.runtime_contract).memory
    chosen = _choose(wanted, workspace, graph, "as asked" if asked else "as runtime_contract.yaml says", asked is None)
    kept = {"folder": str(chosen.folder) if chosen.folder else None, "place": _identify(workspace)}
    publish(workspace.memory_place, f"# The memory of this workspace; null for none.\n{yaml.safe_dump(kept)}")
    return chosen


def read_choice(workspace: Workspace, graph: Path | None = None) -> ChosenMemory | None:
    """The memory that a workspace began with; None before its first run, or where memory.yaml is unreadable.

    A folder outside is believed where the file was written in this very folder of the disk, which a copy is not, or
    where it is the project of the graph, of the working directory or of the workspace itself; elsewhere it is None.
    """
    try:
        data = yaml.safe_load(read_regular(workspace.memory_place, REQUEST_MAX, follow=False))
        folder, place = data["folder"], data.get("place")
        chosen = Path(folder).resolve() if folder else None
    except (OSError, ValueError, yaml.YAMLError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    near = (find_memory_project(each) for each in (graph or Path.cwd(), Path.cwd(), *workspace.root.resolve().parents))
    root = workspace.root.resolve()
    if chosen is None or place == _identify(workspace) or chosen == root or chosen in near:
        return ChosenMemory(chosen, "as this workspace began")
    return None


def _identify(workspace: Workspace) -> str:
    """Of the folder on the disk: a copy is another one."""
    found = workspace.root.stat()
    return f"{found.st_dev}:{found.st_ino}"


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
    folder = ((workspace.root if is_setting else Path.cwd()) / Path(wanted).expanduser()).resolve()
    if is_setting and not folder.is_relative_to(workspace.root.resolve().parent):
        hint, expected = "Name it with --memory if that is meant.", "a folder in the workspace, or beside it"
        raise DefinitionError.of("LEADS_OUT", f"{workspace.runtime_contract}: memory", str(folder), expected, hint)
    return ChosenMemory(folder, why)
