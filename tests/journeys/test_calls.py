"""A goal on procedures of a target: what a procedure says of itself is no verdict, and another skill repairs it."""

import shutil
from pathlib import Path

import pytest

from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.operations.why import why
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.workspace.workspace import Workspace
from tests.served_kit import Served, lead_elsewhere

ROOT = Path(__file__).resolve().parents[2]
SKILL = """---
skill: {name}
description: Lets the lift raise its load by itself.
kind: builtin
tree: {name}
requires: ["visible(mark)"]
guarantees: ["moved(mark)"]
needs: {{observations: [joint_state], actions: [joint_position], capabilities: [counting]}}
---
"""
TREE = """
tree: {name}
description: Calls a procedure of the lift.
root: {{call: {{procedure: {name}, goal: {{height_m: 0.2}}}}}}
"""
GOAL = """
goal: raised
objective: The load is up.
scene: counter
targets: {slide: counter}
sessions:
  up: {skill: rise, target: slide, accept: ["moved(mark)"]}
accept: ["height(mark) >= 0.15"]
"""

pytestmark = pytest.mark.journey


class Hall:
    """A workspace whose lift is served by another program; its procedure `rise` claims what it does not do."""

    def __init__(self, folder):
        library = shutil.copytree(ROOT / "benchmarks" / "library", folder / "library")
        for name in ("rise", "hoist", "misspelt"):
            (library / "skills" / name).mkdir()
            (library / "skills" / name / "SKILL.md").write_text(SKILL.format(name=name))
            (library / "trees" / f"{name}.yaml").write_text(TREE.format(name=name))
        misspelt = library / "trees" / "misspelt.yaml"
        misspelt.write_text(
            misspelt.read_text().replace("procedure: misspelt", "action: rise").replace("_m: 0.2", ": up")
        )
        self.workspace = Workspace.create(folder / "w", Library.open(library))
        (self.workspace.root / "raised.yaml").write_text(GOAL)
        (self.workspace.root / "refused.yaml").write_text(GOAL.replace("skill: rise", "skill: misspelt"))
        self.served = Served(folder, ROOT / "tests" / "conformance" / "lift.py", RISE_LIES="1")
        lead_elsewhere(self.workspace, "counter", self.served.start(), self.served.key.hex())


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    made = Hall(tmp_path_factory.mktemp("hall"))
    yield made
    made.served.close()


@pytest.fixture(scope="module")
def agent(hall):
    with open_bench(hall.workspace, SystemClock()) as made:
        yield made


def test_a_procedure_that_claims_success_is_judged_by_the_world_and_replaced(hall, agent):
    report = agent.mission.run(hall.workspace.root / "raised.yaml", seed=0, goal="raised")
    sessions = agent.mission.ledger.sessions
    first, last = (sessions[report.sessions[index].id] for index in (0, -1))

    assert report.verdict == "success"
    assert first.execution.ended is Ended.COMPLETED, "the procedure says succeeded"
    assert first.decision.verdict == "replan"
    assert (first.contract.skill, last.contract.skill) == ("rise", "hoist")
    assert "✗ accept moved(mark)" in "\n".join(why(hall.workspace.root, first.contract.id).explanation)


def test_a_call_that_does_not_fit_is_refused_before_anything_moves(hall, agent):
    report = agent.mission.run(hall.workspace.root / "refused.yaml", seed=0, goal="refused")
    (refused,) = report.sessions
    explained = "\n".join(why(hall.workspace.root, refused.id).explanation)

    assert (refused.state, refused.ticks) == ("rejected", 0)
    assert "misspelt.yaml:4:15: INVALID_VALUE: found action 'rise'; expected it as procedure" in explained
    assert "UNKNOWN_NAME (field of goal): found 'height'" in explained
