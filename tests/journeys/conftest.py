"""One warm runtime plane for all journeys; each journey is a goal, so a world, of its own."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from phyagentos.agent.mission.mission import Mission
from phyagentos.agent.mission.worklist import Worklist
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from tests.goal_graphs import assert_same_graph, check_recorded_graphs
from tests.journeys.agent_directed import make_project

HERE = Path(__file__).parent
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


@dataclass(frozen=True)
class Plane:
    """A watched workspace, and the missions run in it."""

    workspace: Workspace
    project: Path  # with the goals of `agent_directed`
    mission: Mission

    def run(self, name: str, graph: str = "goal.yaml", seed: int = 1):
        return self.mission.run(HERE / graph, seed=seed, goal=name)

    def bundle(self, session: str) -> Path:
        return self.workspace.evidence_of(session)


@contextmanager
def open_plane(
    root: Path, *, faults: Path | None = None, prepare: Callable[[Workspace], object] = lambda _: None
) -> Iterator[Plane]:
    """`prepare` changes the workspace before it is watched. No goal learns of another: they come in any order."""
    project = make_project(root / "project")
    workspace = Workspace.create(root / "w", Library.open(HERE / "library", EXAMPLE, project))
    prepare(workspace)
    with open_bench(workspace, SystemClock(), faults=faults) as agent:
        yield Plane(workspace, project, agent.mission)


@pytest.fixture(scope="session")
def plane(tmp_path_factory):
    with open_plane(tmp_path_factory.mktemp("journeys"), faults=HERE / "faults.yaml") as plane:
        yield plane


@pytest.fixture(scope="session")
def rough_plane(tmp_path_factory):
    """A plane without faults whose processes are killed and stopped; it is there again for the next who does so."""
    with open_plane(tmp_path_factory.mktemp("rough")) as plane:
        yield plane


@pytest.fixture(scope="session", autouse=True)
def graphs_are_recorded(tmp_path_factory):
    """The agent's graph of a goal, followed to the end or made anew from the journal, is what the records draw."""
    take_in = Worklist.take_in

    def take_in_and_compare(worklist, record):
        take_in(worklist, record)
        if record.ev in {"goal_verdict", "goal_cancelled"} and record.id == f"goal:{worklist.goal}":
            assert_same_graph(worklist.dag, worklist.ledger.goals[worklist.goal])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Worklist, "take_in", take_in_and_compare)
        yield
    check_recorded_graphs(tmp_path_factory.getbasetemp())
