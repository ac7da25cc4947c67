"""The fold of the journal: sessions, goals and the questions that the planes ask of it."""

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.errors import ExecutionError, Problem
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SESSION_TRANSITIONS, IllegalTransition, Side
from phyagentos.protocol.sessions.session import SESSIONS, Ended, Execution
from phyagentos.protocol.sessions.tasks import NodeState
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.journal import Entry
from phyagentos.store.ledger import Ledger
from phyagentos.store.records import Record
from phyagentos.store.views.sessions import build_page, render_page

from .conftest import make_course
from .histories import fold

EXECUTION = Execution(ended=Ended.COMPLETED, evidence="evidence/s", outputs={"place_site": [0.1, 0.2, 0.3]}, ticks=600)
ATTEMPT = Attempt(
    verdict=Verdict.REPLAN,
    criteria=(Criterion(text="inside(a, b)", kind="accept", truth=Truth.FALSE, measured={"distance_m": 0.31}),),
    cause="GRASP_LOST",
)
GOAL = [
    Entry("goal:g", "goal_submitted", {"graph": "tidy", "seed": 7, "objective": "Tidy"}),
    Entry(
        "goal:g",
        "goal_compiled",
        {"nodes": {"red": {"skill": "pick_and_place"}, "blue": {"after": ["red"]}}, "accept": ["on(a, b)"]},
    ),
]


def test_a_session_carries_what_its_records_said(open_journal, contract, submit):
    agent, runtime = open_journal(), open_journal(Side.RUNTIME, "watchdog")
    agent.commit([submit("s")])
    runtime.commit(make_course("s", EXECUTION, {"plan": {"bridges": []}}))
    agent.commit([Entry("s", "verify"), Entry("s", "replan", {"attempt": ATTEMPT})])

    status = fold(agent.read_new()).sessions["s"]

    assert status.contract == contract("s")
    assert (status.state, status.epoch, status.claimed_by) == ("replanned", 1, "watchdog")
    assert (status.execution, status.attempts) == (EXECUTION, (ATTEMPT,))

    assert status.updated_at.startswith("1970-01-12T")


def test_the_problems_of_a_rejection_stay_typed_and_stand_in_the_view(open_journal, submit):
    open_journal().commit([submit("s")])
    journal = open_journal(Side.RUNTIME)
    unmet = Problem(code="PRECONDITION_UNMET", address="requires", subject="visible(red_cube)")
    plain = {"code": "NOT_GRASPABLE", "address": "dry run", "found": "0.1 m", "expected": "", "hint": ""}
    journal.commit([Entry("s", "reject", {"reason": "r", "problems": [msgspec.to_builtins(unmet), plain]})])
    ledger = fold(journal.read_new())

    problems = (unmet, Problem(code="NOT_GRASPABLE", address="dry run", found="0.1 m"))
    assert ledger.sessions["s"].problems == problems
    assert read_document(render_page(build_page(ledger)), SESSIONS).blocks["s"].problems == problems


def test_who_waits_is_answered_by_priority_and_age_and_who_waits_for_a_verdict_is_alive(open_journal, submit):
    agent, runtime = open_journal(), open_journal(Side.RUNTIME)
    agent.commit([submit("a"), submit("b", target="ur5e"), submit("c", priority=2), submit("d"), submit("e")])
    runtime.commit([Entry("a", "claim"), Entry("a", "check"), Entry("a", "release", epoch=1)])
    ledger = fold(agent.read_new())
    assert [status.contract.id for status in ledger.iter_pending()] == ["c", "a", "b", "d", "e"]
    assert ledger.sessions["a"].epoch == 1
    runtime.commit([*make_course("b", EXECUTION), Entry("c", "reject", {"reason": "no"})])
    fold(agent.read_new(), ledger)
    assert [status.contract.id for status in ledger.live_sessions()] == ["a", "b", "d", "e"]


def test_a_cancelled_goal_says_so_until_it_has_its_verdict(open_journal):
    agent, operator = open_journal(), open_journal(Side.OPERATOR)
    operator.commit([GOAL[0], Entry("goal:g", "goal_cancelled", {"reason": "supper"})])
    goal = fold(agent.read_new()).goals["g"]
    assert (goal.is_cancelled, goal.reason, goal.verdict) == (True, "supper", "")
    (record,) = agent.commit([Entry("goal:g", "goal_verdict", {"verdict": "failure"})])
    assert (record.source, record.to, record.epoch) == (None, None, None)


def test_a_goal_follows_its_nodes_from_waiting_to_a_verdict(open_journal, submit):
    agent = open_journal()
    ledger = Ledger()
    agent.commit(GOAL)
    goal = fold(agent.read_new(), ledger).goals["g"]
    assert (goal.graph, goal.seed, goal.objective, goal.accept) == ("tidy", 7, "Tidy", ("on(a, b)",))
    assert {name: node.state for name, node in goal.nodes.items()} == {"red": "waiting", "blue": "waiting"}

    agent.commit([Entry("node:g/red", "node_ready"), submit("g.red", goal="g", node="red")])
    assert fold(agent.read_new(), ledger).goals["g"].nodes["red"].state is NodeState.ACTIVE

    agent.commit([Entry("node:g/red", "child_of", {"child": "g.red.r1", "parent": "g.red"})])
    agent.commit([Entry("node:g/red", "budget_spent"), submit("g.red.r1", goal="g", node="red", parent="g.red")])
    agent.commit([Entry("node:g/red", "node_done"), Entry("node:g/blue", "node_blocked", {"reason": "gone"})])
    agent.commit([Entry("node:g/red", "invalidated")])
    agent.commit(
        [
            Entry(
                "goal:g", "goal_verdict", {"verdict": "failure", "reason": "blue is gone", "criteria": ATTEMPT.criteria}
            )
        ]
    )
    goal = fold(agent.read_new(), ledger).goals["g"]

    assert goal.nodes["red"].state is NodeState.INVALIDATED
    assert goal.nodes["red"].sessions == ("g.red", "g.red.r1")
    assert (goal.nodes["blue"].state, goal.nodes["blue"].reason, goal.nodes["blue"].after) == (
        "blocked",
        "gone",
        ("red",),
    )
    assert (goal.verdict, goal.reason, goal.replans, goal.criteria) == ("failure", "blue is gone", 1, ATTEMPT.criteria)


def test_a_repair_changes_nobody(open_journal, submit):
    agent = open_journal()
    agent.commit([submit("s")])
    with next(agent.folder.glob("*.md")).open("ab") as file:
        file.write(b"<!-- phy1 00")
    before = fold(agent.read_new())
    late = open_journal()
    after = fold(late.read_new())

    assert after.sessions == before.sessions
    assert after.seq == before.seq + 1


@pytest.mark.parametrize(
    ("id", "ev", "to", "body"),
    [
        ("goal:g", "goal_submitted", None, "seed: 1\n[}"),
        ("goal:g", "goal_submitted", None, "seed: many"),
        ("goal:g", "goal_submitted", None, "objective: &a [*a]"),
        ("node:g", "node_done", None, "reason: x"),
        ("s", "submit", "pending", "objectiv: x"),
        ("s", "submit", "dancing", None),
    ],
)
def test_an_intact_record_that_no_plane_writes_is_damage_of_the_journal_by_its_number(id, ev, to, body):
    markdown = "" if body is None else f"\n```yaml\n{body}\n```\n"
    record = Record(id=id, ev=ev, to=to, by="x", side="agent", at="", seq=3, markdown=markdown)
    with pytest.raises(ExecutionError, match=rf"JOURNAL_DAMAGED: record 3 \({ev} of {id}\)"):
        Ledger().apply(record)


@pytest.mark.slow
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_the_fold_agrees_with_the_journal_after_any_history(tmp_path_factory, submit, data):
    from phyagentos.store.journal import Journal
    from phyagentos.testing import ManualClock

    root = tmp_path_factory.mktemp("lane")
    journals = {s: Journal(root, side=s, by=s.value, clock=ManualClock(), durable=False) for s in Side}
    ids = ["a", "b", "c"]
    journals[Side.AGENT].commit([submit(id) for id in ids])
    expected = dict.fromkeys(ids, "pending")
    rows = sorted(SESSION_TRANSITIONS, key=lambda row: row.trigger)
    for _ in range(data.draw(st.integers(0, 20))):
        id, row = data.draw(st.sampled_from(ids)), data.draw(st.sampled_from(rows))
        try:
            (record,) = journals[row.by[0]].commit([Entry(id, row.trigger)])
        except IllegalTransition:
            continue
        assert record.source == expected[id]
        expected[id] = record.to
    ledgers = [fold(journal.read_new()) for journal in journals.values()]
    for journal in journals.values():
        journal.close()

    for ledger in ledgers:
        assert {id: status.state for id, status in ledger.sessions.items()} == expected
        live = [id for id in ids if expected[id] not in FINAL_STATES]
        assert [status.contract.id for status in ledger.live_sessions()] == live
    assert msgspec.json.encode(ledgers[0].sessions) == msgspec.json.encode(ledgers[1].sessions)
