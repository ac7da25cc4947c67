"""The timeline: what stands where on it, by the records alone."""

import pytest

from phyagentos.clock import SystemClock
from phyagentos.operations.answer import contest
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.tasks import Relation
from phyagentos.store.journal import Entry, Journal
from phyagentos.view.timeline import BARS_MARKED, SLIVER, Timeline, measure_length, read_timeline
from tests.view.conftest import HOSTILE
from tests.view.test_page import read, see


def test_a_session_is_a_bar_in_its_targets_lane_and_its_revision_is_linked_to_it(reported):
    timeline = read_timeline(reported, reported.find_goal())
    first, second = timeline.lanes["panda"]
    assert (first.name, second.name) == ("a", "a.r1")
    assert [span.phase for span in first.spans] == ["checking", "running", "judging"]
    assert 0.0 <= first.from_s <= first.to_s <= second.from_s <= second.to_s <= timeline.length_s
    ((link),) = timeline.links
    assert (link.relation, link.before, link.after) == (Relation.REPLAN, first, second)
    assert timeline.waiting == []


def test_what_evidence_says_in_simulated_time_stands_within_the_time_in_which_the_session_ran(reported):
    (first, _) = read_timeline(reported, reported.find_goal()).lanes["panda"]
    (mark,) = first.marks
    assert (mark.kind, first.sim_s) == ("guard", (3.5, pytest.approx(7.4)))
    assert "JOINT_ACCELERATION" in mark.text
    assert first.ran.from_s <= mark.at_s <= first.ran.to_s


def test_the_moment_at_which_a_person_took_over_is_marked_with_who_it_was(documents, desk):
    third = desk.submit("b")
    desk.execute(third, events=[{"time_s": 4.0, "kind": "taken_over", "details": {"by": HOSTILE}}])
    documents.refresh()
    bar = read_timeline(documents, documents.find_goal()).lanes["panda"][-1]
    ((mark),) = bar.marks
    assert (mark.kind, mark.text) == ("person", f"taken over by {HOSTILE} at 4.00 s simulated")
    assert bar.ran.from_s <= mark.at_s <= bar.ran.to_s
    shown = read(documents, "timeline", session=third)
    assert "■ taken over by a person" in see(shown)
    assert HOSTILE not in shown


def test_a_session_without_a_worker_waits_and_a_request_of_an_operator_is_marked(documents, desk):
    waiting = desk.submit("b")
    documents.refresh()
    assert [bar.name for bar in read_timeline(documents, documents.find_goal()).waiting] == ["b"]
    with_hand = Journal(desk.workspace.root, side=Side.OPERATOR, by="person", clock=SystemClock())
    with_hand.read_new()
    with_hand.commit([Entry(waiting, "cancel", {"reason": "supper"})])
    with_hand.close()
    documents.refresh()
    timeline = read_timeline(documents, documents.find_goal())
    assert timeline.waiting == []
    assert [(mark.kind, mark.text) for mark in timeline.requests] == [("request", "cancel by person")]


def test_a_judgement_that_comes_days_after_a_verdict_makes_no_run_longer(documents, desk):
    goal = documents.find_goal()
    before, states = measure_length(documents, goal), [*documents.passages["tidy-7.a"]]
    contest(desk.workspace.root, "tidy-7.a", because=f"It leans. {HOSTILE}", by="ann")
    documents.refresh()
    assert measure_length(documents, goal) == before
    assert documents.passages["tidy-7.a"] == states
    shown = see(read(documents, "story", session="tidy-7.a"))
    assert "Contested: success ann at 2" in shown
    assert "0 criteria" not in shown


def test_many_narrow_neighbours_of_one_state_are_one_bar_and_the_chosen_one_stays_alone(documents, desk):
    ids = [desk.submit(f"n{number}") for number in range(BARS_MARKED + 10)]
    with_hand = Journal(desk.workspace.root, side=Side.OPERATOR, by="person", clock=SystemClock())
    with_hand.read_new()
    with_hand.commit([Entry(id, "cancel", {"reason": "supper"}) for id in ids])  # at one moment
    with_hand.close()
    documents.refresh()
    goal = documents.find_goal()
    bars = read_timeline(documents, goal, ids[20]).lanes["panda"]
    sliver_s = SLIVER * read_timeline(documents, goal).length_s
    assert sum(bar.number for bar in bars) == len(documents.ledger.sessions)
    assert [bar.number for bar in bars if bar.status.contract.id == ids[20]] == [1]
    assert all(bar.to_s - bar.from_s <= sliver_s for bar in bars if bar.number > 1)
    assert any(bar.number > 1 and " … " in bar.name for bar in bars)


@pytest.mark.parametrize(
    ("length_s", "ticks"), [(0.0, [0.0]), (14.5, [0, 2, 4, 6, 8, 10, 12, 14]), (600.0, [0, 120, 240, 360, 480, 600])]
)
def test_the_axis_has_few_round_ticks(length_s, ticks):
    timeline = Timeline("2026-01-01T00:00:00Z", length_s, {}, [], [], [])
    assert timeline.ticks == ticks
    assert all(0.0 <= timeline.share(tick) <= 100.0 for tick in timeline.ticks)
