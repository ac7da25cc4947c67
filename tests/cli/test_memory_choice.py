"""Which memory a run has: one for the project, kept by the workspace, and none where none is asked for."""

import shutil

import pytest

from phyagentos.agent.memory.memory import Memory
from phyagentos.assembly.memory_choice import choose_memory, find_memory_project, read_choice
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.workspace.workspace import Workspace
from tests.agent.memory.conftest import make_correction


@pytest.fixture
def project(tmp_path):
    """A project with one goal graph; gives the graph's path."""
    graph = tmp_path / "kitchen" / "goal_graphs" / "tidy.yaml"
    graph.parent.mkdir(parents=True)
    graph.write_text("goal: tidy\n")
    return graph


@pytest.fixture
def workspace(tmp_path):
    return Workspace.create(tmp_path / "w", Library((find_shipped_root(),)))


def test_runs_of_a_project_share_its_memory(project, workspace, tmp_path):
    kitchen = project.parent.parent
    another = Workspace.create(tmp_path / "v", Library((find_shipped_root(),)))
    assert choose_memory(workspace, project).folder == choose_memory(another, project).folder == kitchen


def test_a_graph_that_ships_belongs_to_the_working_directory_where_that_is_a_project(project, monkeypatch):
    shipped = find_shipped_root() / "goal_graphs" / "tidy_table.yaml"
    kitchen = project.parent.parent
    assert find_memory_project(shipped, kitchen) == kitchen
    assert find_memory_project(shipped, kitchen.parent) is None
    assert find_memory_project(shipped, find_shipped_root()) is None


def test_without_a_project_the_workspace_has_its_own_and_says_so(workspace, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    chosen = choose_memory(workspace, tmp_path / "tidy.yaml")
    assert chosen.folder == workspace.root
    assert "no folder with goal_graphs/ makes this a project" in str(chosen)


def test_a_workspace_of_before_goes_on_with_its_own_records(project, workspace):
    workspace.memory.mkdir()
    assert choose_memory(workspace, project).folder == workspace.root
    assert read_choice(workspace) is None


def test_a_workspace_goes_on_with_the_memory_that_it_began_with(project, workspace, tmp_path):
    assert choose_memory(workspace, project, "none").folder is None
    assert choose_memory(workspace, project).folder is None
    assert choose_memory(workspace, project, str(tmp_path / "m")).folder == tmp_path / "m"
    assert choose_memory(workspace, project).folder == tmp_path / "m"


@pytest.mark.parametrize(("said", "folder"), [("none", None), ("workspace", "w"), ("../elsewhere", "elsewhere")])
def test_the_setting_decides_where_nothing_was_asked(project, workspace, tmp_path, said, folder):
    settings = workspace.runtime_contract
    settings.write_text(f"{settings.read_text()}memory: {said}\n")
    assert choose_memory(workspace, project).folder == (tmp_path / folder if folder else None)


def test_paos_memory_of_a_workspace_shows_the_memory_that_it_has(project, workspace, paos):
    chosen = choose_memory(workspace, project)
    memory = Memory(chosen.folder / "memory", clock=SystemClock(), by="test", durable=False)
    memory.record(make_correction())
    assert "soap" in paos("memory", "show", "-w", workspace.root).out
    assert "soap" in paos("memory", "show", "-w", chosen.folder).out


def copy(workspace, to):
    shutil.copytree(workspace.root, to, symlinks=True)
    return Workspace.open(to)


def test_a_copy_of_a_workspace_leads_nowhere_outside(workspace, project, tmp_path, monkeypatch):
    elsewhere = tmp_path / "system"
    assert choose_memory(workspace, tmp_path / "tidy.yaml", str(elsewhere)).folder == elsewhere
    (tmp_path / "far").mkdir()
    monkeypatch.chdir(tmp_path / "far")
    copied = copy(workspace, tmp_path / "far" / "copy")
    assert read_choice(copied) is None
    assert choose_memory(copied, tmp_path / "far" / "tidy.yaml").folder == copied.root
    assert choose_memory(copied, tmp_path / "far" / "tidy.yaml", str(elsewhere)).folder == elsewhere


@pytest.mark.parametrize("said", ["/var/lib", "../../elsewhere", "~/other"])
def test_a_setting_leads_no_further_than_beside_the_workspace(workspace, tmp_path, said):
    workspace.runtime_contract.write_text(f"{workspace.runtime_contract.read_text()}memory: {said}\n")
    with pytest.raises(DefinitionError, match="LEADS_OUT"):
        choose_memory(workspace, tmp_path / "tidy.yaml")
