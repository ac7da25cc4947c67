"""A session that serves no goal: dropped into the inbox, run as any other, judged by the same verifier."""

import pytest

from phyagentos.agent.judging.review import judge_goalless_sessions
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.edits.edit_intake import EditIntake
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.renderer import Views

from .conftest import Play, put

REQUEST = """kind: submit
contract:
  objective: Put the red cube into the red tray.
  skill: pick_and_place
  target: panda
  parameters: {object: red_cube, destination: red_tray}
  accept: ["inside(red_cube, red_tray)"]
  scene: {name: table}
"""


class ByHand:
    def __init__(self, stage) -> None:
        self.stage, self.workspace = stage, stage.workspace
        self.agent = Journal(self.workspace.root, side=Side.AGENT, by="judge", clock=SystemClock(), durable=False)
        self.edits = EditIntake(self.workspace, SystemClock(), durable=False)
        self.views = Views(self.workspace, self.agent.folder, SystemClock(), self.edits)

    def drop(self, name):
        (self.workspace.inbox / "new" / f"{name}.yaml").write_text(REQUEST)
        self.views.refresh(at_once=True)
        self.stage.runtime.on_change(None, None)

    def state(self, id):
        self.views.refresh(at_once=True)
        return self.views.ledger.sessions[id].state

    def close(self):
        self.views.close()
        self.edits.close()
        self.agent.close()


@pytest.fixture
def open_goalless(make_stage):
    opened = []

    def open_one(script=None):
        opened.append(ByHand(make_stage(script)))
        return opened[-1]

    yield open_one
    for each in opened:
        each.close()


def test_it_runs_waits_for_a_judge_and_succeeds_on_evidence(open_goalless):
    goalless = open_goalless()
    goalless.drop("red-1")
    assert goalless.state("red-1") == "awaiting_verification"

    ((id, attempt),) = judge_goalless_sessions(goalless.workspace, goalless.agent)

    assert (id, attempt.verdict) == ("red-1", "success")
    assert goalless.state("red-1") == "succeeded"
    assert "**Verdict 1:** success" in goalless.workspace.sessions_document.read_text()
    assert judge_goalless_sessions(goalless.workspace, goalless.agent) == []


def test_it_fails_without_a_child_when_its_objective_was_not_met(open_goalless):
    goalless = open_goalless({"red-1": lambda world, session: Play(world=put(world, "red_cube", (0.5, 0.0, 0.02)))})
    goalless.drop("red-1")

    ((_, attempt),) = judge_goalless_sessions(goalless.workspace, goalless.agent)

    assert attempt.verdict == "failure"
    assert "The budget of 0 replans is spent." in attempt.reason
    assert goalless.state("red-1") == "failed"


def test_a_session_of_a_goal_is_left_to_its_mission(open_goalless, write_graph):
    goalless = open_goalless()
    goalless.drop("red-1")
    goalless.agent.commit([Entry("red-1", "verify")])  # its judge was interrupted
    graph = write_graph(
        "goal: one\nobjective: o\nscene: table\ntargets: {arm: panda}\nsessions:\n  green:\n"
        "    skill: pick_and_place\n    target: arm\n    with: {object: green_cube, destination: green_tray}\n"
        'accept: ["inside(green_cube, green_tray)"]\n'
    )
    assert goalless.stage.pursue(graph).verdict == "success"
    assert goalless.state("red-1") == "verifying"

    assert [id for id, _ in judge_goalless_sessions(goalless.workspace, goalless.agent)] == ["red-1"]
