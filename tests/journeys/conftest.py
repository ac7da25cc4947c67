"""One warm runtime plane for all journeys; each journey is a goal, so a world, of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from phyagentos.agent.mission.worklist import Worklist
from phyagentos.assembly.agent_plane import MemoryUse, open_agent
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from tests.goal_graphs import assert_same_graph, check_recorded_graphs

HERE = Path(__file__).parent
KIT = HERE.parents[1] / "kits" / "rollouts"
EXAMPLE = HERE.parents[1] / "examples" / "projects" / "01_yaml_skill"
STATECHARTS = HERE / "test_statecharts.py"
_FILES: set[Path] = set()  # of the journeys that this run goes through


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """What is said of all journeys comes after them: last, and never in one of several processes."""
    items.sort(key=lambda item: item.path == STATECHARTS)
    _FILES.update(item.path for item in items)
    if "PYTEST_XDIST_WORKER" in os.environ:
        last = [item for item in items if item.path == STATECHARTS]
        config.hook.pytest_deselected(items=last)
        items[:] = items[: len(items) - len(last)]


@pytest.fixture(scope="session")
def journeys(pytestconfig, tmp_path_factory):
    """The folder that journeys have left their workspaces in: of this run, or of the one that is named."""
    return pytestconfig.option.journeys or tmp_path_factory.getbasetemp()


@pytest.fixture(scope="session")
def is_of_every_journey(pytestconfig):
    """Whether no file of this folder was left out."""
    return pytestconfig.option.journeys is not None or set(HERE.glob("test_*.py")) <= _FILES


class Plane:
    """A watched workspace, and the missions run in it."""

    def __init__(self, root: Path, faults: Path | None = None) -> None:
        self.workspace = Workspace.create(root, Library.open(HERE / "library", EXAMPLE))
        command = [sys.executable, "-m", "phyagentos", "watch", "--workspace", str(root), "--no-pictures"]
        command += ["--trust-python", *(["--faults", str(faults)] if faults else [])]
        with (self.workspace.logs / "watch.log").open("wb") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log)
        self._agent = open_agent(
            self.workspace,
            SystemClock(),
            by="journey",
            memory_use=MemoryUse.NONE,  # journeys share the workspace, in any order
            is_runtime_alive=lambda _: self.process.poll() is None,
        )
        self.mission = self._agent.__enter__().mission

    def run(self, name: str, graph: str = "goal.yaml", seed: int = 1):
        return self.mission.run(HERE / graph, seed=seed, goal=name)

    def bundle(self, session: str) -> Path:
        return self.workspace.evidence_of(session)

    def stop(self) -> None:
        self.process.terminate()
        self.process.wait(30)
        self._agent.__exit__(None, None, None)


@pytest.fixture(scope="session")
def plane(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(KIT), prepend=os.pathsep)  # its processes find it, as if it were installed
        plane = Plane(tmp_path_factory.mktemp("journeys") / "w", HERE / "faults.yaml")
    yield plane
    plane.stop()


@pytest.fixture(scope="session")
def rough_plane(tmp_path_factory):
    """A plane without faults whose processes are killed and stopped; it is there again for the next who does so."""
    plane = Plane(tmp_path_factory.mktemp("rough") / "w")
    yield plane
    plane.stop()


@pytest.fixture
def make_plane(tmp_path):
    """Planes of one's own, for what does harm to processes."""
    planes: list[Plane] = []

    def make(name: str = "w") -> Plane:
        planes.append(Plane(tmp_path / name))
        return planes[-1]

    yield make
    for each in planes:
        each.stop()


@pytest.fixture(autouse=True)
def graphs_are_recorded(monkeypatch, tmp_path_factory):
    """The agent's graph of a goal, followed to the end or made anew from the journal, is what the records draw."""
    take_in = Worklist.take_in

    def take_in_and_compare(worklist, record):
        take_in(worklist, record)
        if record.ev in {"goal_verdict", "goal_cancelled"} and record.id == f"goal:{worklist.goal}":
            assert_same_graph(worklist.dag, worklist.ledger.goals[worklist.goal])

    monkeypatch.setattr(Worklist, "take_in", take_in_and_compare)
    yield
    check_recorded_graphs(tmp_path_factory.getbasetemp())
