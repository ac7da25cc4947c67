"""A goal on a target without joints: calls of its tools, judged by what it carries afterwards."""

import json
import shutil
from pathlib import Path

import pytest

from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.operations.rerun import rerun
from phyagentos.operations.verify import verify
from phyagentos.operations.why import why
from phyagentos.operations.workspaces import find_session
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import read_environment
from phyagentos.view.documents import Documents
from phyagentos.view.pages import NOTHING, PanelRenderer
from phyagentos.view.panels import PANELS, Query
from tests.following import wait_until

PROJECT = Path(__file__).resolve().parents[2] / "examples" / "projects" / "11_workbench"
WOOD = """
goal: {scene}
objective: Carry wood.
scene: {scene}
targets: {{maker: maker}}
sessions:
  wood: {{skill: fetch, target: maker, with: {{item: wood, place: tree, amount: 2}}, timeout_s: 2.0}}
accept: ["holds(wood) >= 2"]
"""

CLAIM = """        if self.scene == "claimed":
            return f"has {wanted} {item}"
"""

pytestmark = pytest.mark.journey


def make_project(folder):
    """The example, and two scenes more: in one nothing grows, in the other its tool `gather` claims what it has not."""
    project = shutil.copytree(PROJECT, folder / "project")
    body = project / "robots" / "maker" / "workbench.py"
    text = body.read_text()
    for line, other in (
        ("        if not snapshot:\n", "        self.scene = scene\n        if not snapshot:\n"),
        ("self._random.random() < 0.6", 'self.scene != "barren" and self._random.random() < 0.6'),
        (
            "        for _ in range(STEPS_MAX):\n            if",
            CLAIM + "        for _ in range(STEPS_MAX):\n            if",
        ),
    ):
        assert text.count(line) == 1
        text = text.replace(line, other)
    body.write_text(text)
    for scene in ("barren", "claimed"):
        clearing = (project / "scenes" / "clearing.yaml").read_text()
        (project / "scenes" / f"{scene}.yaml").write_text(clearing.replace("scene: clearing", f"scene: {scene}"))
        (project / "goal_graphs" / f"{scene}.yaml").write_text(WOOD.format(scene=scene))
    return project


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    project = make_project(folder)
    workspace = Workspace.create(folder / "w", Library.open(project))
    with open_bench(workspace, SystemClock()) as agent:
        yield workspace, lambda name: agent.mission.run(project / "goal_graphs" / f"{name}.yaml", seed=3, goal=name)


@pytest.fixture(scope="module")
def done(bench):
    """The example's goal, run once, and ENVIRONMENT.md after it."""
    workspace, run = bench
    report = run("stone")
    wait_until(lambda: "2 stone" in workspace.environment.read_text(), "the world after the last session")
    return workspace, report, workspace.environment.read_text()


def read_decision(workspace, session):
    return find_session(workspace.root, session)[1].decision


def read_first(workspace, report):
    """Execution and trace of the first session."""
    folder = workspace.evidence_of(report.sessions[0].id)
    lines = (folder / "trace.jsonl").read_text().splitlines()
    return json.loads((folder / "execution.json").read_text()), [json.loads(each) for each in lines]


def test_a_chain_of_tools_is_carried_out_judged_and_documented(done):
    _, report, environment = done
    assert report.verdict == "success"
    assert len(report.sessions) == 6

    supplies = read_environment(environment).targets["maker"]
    assert supplies.inventory == {"pickaxe": 1, "plank": 3, "stick": 2, "stone": 2}
    assert "| 1 pickaxe, 3 plank, 2 stick, 2 stone | food" in environment


def test_what_it_carried_and_how_it_fared_stand_in_the_trajectory(done):
    workspace, report, _ = done
    course = read_arrays(workspace.evidence_of(report.sessions[0].id) / "trajectory.npz")
    assert course["item.wood"][-1] == 2.0
    assert course["vital.food"][0] == 9.0
    assert course["base"].shape == (len(course["time_s"]), 3)
    assert course["q_measured"].shape == (len(course["time_s"]), 0)


def test_its_verdict_is_formed_again_and_its_bits_are_repeated(done):
    workspace, report, _ = done
    for session in (report.sessions[0].id, report.sessions[-1].id):
        recorded = read_decision(workspace, session)
        again = verify(workspace.root, session)
        assert (again.verdict, again.judgement.verdict) == ("success", "success")
        assert again.judgement.criteria == recorded.criteria
        assert rerun(workspace.root, session).differences == ()


def test_the_page_shows_its_vitals_inventory_and_path(done):
    workspace, report, _ = done
    documents = Documents(workspace.root)
    documents.refresh()
    render = PanelRenderer(documents, lambda: {"actions": False, "live": False}).render
    panels = {each.name: render(each, Query(session=report.sessions[-1].id)) for each in PANELS}
    for title in ("Vitals", "Inventory", "Daylight"):
        assert f"<figcaption>{title}" in panels["motion"]
    assert "Joint" not in panels["motion"]
    assert "<title>rock</title>" in panels["map"]
    assert panels["scene"] == NOTHING


def test_a_tool_that_claims_what_it_did_not_do_is_no_success(bench):
    workspace, run = bench
    report = run("claimed")
    execution, _ = read_first(workspace, report)

    assert report.verdict != "success"
    assert execution["ended"] == Ended.COMPLETED, "the tool says that it has two"
    explained = "\n".join(why(workspace.root, report.sessions[0].id).explanation)
    assert "✗ accept holds(wood) >= 2: maker carries 0 wood" in explained


def test_a_session_ends_when_its_budget_of_steps_is_spent(bench):
    workspace, run = bench
    report = run("barren")
    execution, trace = read_first(workspace, report)

    assert report.verdict != "success"
    assert execution["ended"] == Ended.TIMED_OUT
    assert execution["ticks"] == pytest.approx(20, abs=2), "2 s of 0.1 s a step"
    assert trace[-1]["status"] == "INVALID", "the tool was interrupted"
