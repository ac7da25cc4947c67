"""TASK.md stays readable: it forgets what is long over, and says so; it draws what can be drawn."""

import pytest

from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.sessions.session import Ended, Execution, SessionStatus
from phyagentos.protocol.sessions.tasks import TASK, GoalStatus, NodeState, NodeStatus, Replan
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.store.ledger import Ledger
from phyagentos.store.views.tasks import (
    ADVISED_SHOWN,
    EDGES_DRAWN,
    GOALS_SHOWN,
    NODES_DRAWN,
    describe_fault,
    render_tasks,
)
from phyagentos.testing import make_contract


@pytest.fixture
def ledger():
    return Ledger()


def add_goals(ledger, *goals):
    for goal in goals:
        ledger.goals[goal.id] = goal
        ledger.goal_count += 1


def make_status(id, advice=(), **facts):
    return SessionStatus(contract=make_contract(id=id, node="n", advice=advice), state="replanned", **facts)


def test_of_the_goals_that_are_over_the_latest_are_shown_and_of_the_others_all(ledger):
    add_goals(ledger, GoalStatus(id="open-0"))
    add_goals(ledger, *(GoalStatus(id=f"over-{number}", verdict="success") for number in range(GOALS_SHOWN + 3)))
    add_goals(ledger, GoalStatus(id="gone", is_cancelled=True), GoalStatus(id="open-1"))
    text = render_tasks(ledger)
    shown = list(read_document(text, TASK).blocks)

    latest = [f"over-{number}" for number in range(GOALS_SHOWN + 2, 3, -1)]
    assert shown == ["open-1", "gone", *latest, "open-0"]
    assert "4 older goals are not shown; their records are in `sessions/`, their graphs in `goals/`.\n" in text


def test_goals_that_the_ledger_has_forgotten_are_counted(ledger):
    add_goals(ledger, GoalStatus(id="g"))
    ledger.goal_count = 8

    assert "7 older goals are not shown" in render_tasks(ledger)


@pytest.mark.parametrize(
    ("nodes", "after", "is_drawn"),
    [(NODES_DRAWN, 0, True), (NODES_DRAWN + 1, 0, False), (100, 4, True), (100, 5, False)],
)
def test_a_graph_is_drawn_while_a_forge_can_draw_it(ledger, nodes, after, is_drawn):
    names = [f"n{number}" for number in range(nodes)]
    graph = {name: NodeStatus(after=tuple(names[:after])) for name in names}
    add_goals(ledger, GoalStatus(id="g", nodes=graph))
    text = render_tasks(ledger)

    assert ("```mermaid" in text) is is_drawn
    assert (f"The graph has {nodes} nodes and {nodes * after} edges, too many to draw" in text) is not is_drawn
    assert (nodes <= NODES_DRAWN and nodes * after <= EDGES_DRAWN) is is_drawn
    assert text.count("| waiting |") == nodes


def test_why_a_session_was_revised_is_read_from_its_verdict_else_from_its_rejection(ledger):
    attempt = Attempt(verdict=Verdict.REPLAN, criteria=(), cause="GRASP_LOST", reason="the cube slipped.")
    replan = Replan(session="a", child="a.r1", reason="pick again at half speed")
    assert describe_fault(replan, ledger) == ""

    ledger.sessions["a"] = make_status("a", reason="panda is busy")
    assert describe_fault(replan, ledger) == "panda is busy"

    ledger.sessions["a"] = make_status("a", attempts=(attempt,))
    assert describe_fault(replan, ledger) == "GRASP_LOST: the cube slipped."


def test_a_session_is_linked_to_its_evidence_where_it_left_some(ledger):
    execution = Execution(ended=Ended.COMPLETED, evidence="evidence/a")
    ledger.sessions |= {"a": make_status("a", execution=execution), "b": make_status("b")}
    add_goals(ledger, GoalStatus(id="g", nodes={"n": NodeStatus(state=NodeState.ACTIVE, sessions=("old", "a", "b"))}))

    assert "| old, [a](evidence/a) (replanned), b (replanned) |" in render_tasks(ledger)


def test_a_cancelled_goal_says_why(ledger):
    add_goals(ledger, GoalStatus(id="g", is_cancelled=True, reason="dinner\nis ready"), GoalStatus(id="h"))
    text = render_tasks(ledger)

    assert "- **Verdict:** cancelled, dinner is ready\n" in text
    assert "- **Verdict:** none yet\n" in text


def test_what_memory_changed_is_one_line_a_session_with_the_lesson(ledger):
    advice = ("speed 0.5: lesson lesson-1a2b, 4 of 4 with it and 1 of 5 without", "as of memory/7:3f")
    ledger.sessions |= {"a": make_status("a", advice=advice), "b": make_status("b")}
    add_goals(ledger, GoalStatus(id="g", nodes={"n": NodeStatus(state=NodeState.DONE, sessions=("old", "a", "b"))}))
    text = render_tasks(ledger)

    (line,) = (line for line in text.splitlines() if line.startswith("- **Memory changed"))
    assert line == f"- **Memory changed a:** {'; '.join(advice)}"
    read_document(text, TASK)


def test_where_memory_changed_many_sessions_the_rest_are_counted(ledger):
    ids = tuple(f"s{number}" for number in range(ADVISED_SHOWN + 3))
    ledger.sessions |= {id: make_status(id, advice=("speed 0.5: lesson l",)) for id in ids}
    add_goals(ledger, GoalStatus(id="g", nodes={"n": NodeStatus(sessions=ids)}))
    text = render_tasks(ledger)

    assert text.count("- **Memory changed s") == ADVISED_SHOWN
    assert "- **Memory changed** 3 more sessions; `paos why SESSION` shows how.\n" in text
