"""What a page chooses by itself, and how far a run has begun."""

import os

from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.heartbeats import Heartbeat, write_heartbeat
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.workspace.process_lock import RUNTIME_LOCK, WATCHDOG_LOCK, become_sole
from phyagentos.protocol.world.truth import Truth
from phyagentos.view.documents import Documents
from phyagentos.view.panels import PANELS
from tests.view.conftest import GOAL
from tests.view.test_page import read, see


def test_a_session_that_failed_is_chosen_before_a_later_one_that_succeeded(desk):
    desk.record(GOAL, "goal_submitted", graph="tidy", seed=7, objective="Tidy.")
    desk.record(GOAL, "goal_compiled", nodes={name: {"objective": name} for name in "ab"}, accept=[], constraints=[])
    for node, verdict, truth in (("a", Verdict.FAILURE, Truth.FALSE), ("b", Verdict.SUCCESS, Truth.TRUE)):
        desk.execute(session := desk.submit(node))
        desk.judge(session, verdict, truth)
    documents = Documents(desk.workspace.root)
    documents.refresh()
    assert documents.find_session().contract.id == "tidy-7.a"
    running = desk.submit("b", 1)
    documents.refresh()
    assert documents.find_session().contract.id == running


def test_of_a_run_that_was_met_in_the_end_what_was_replanned_is_chosen(documents):
    assert [each.state for each in documents.ledger.sessions.values()] == ["replanned", "succeeded"]
    assert documents.find_session().contract.id == "tidy-7.a"


def test_a_run_is_followed_from_its_first_second(desk):
    place = desk.workspace
    documents = Documents(place.root)

    def look():
        documents.refresh()
        return [name for name, is_done in documents.list_stages().items() if is_done]

    assert look() == []
    assert "not running" in see(read(documents, "runtime"))
    become_sole(place.root / RUNTIME_LOCK, SystemClock(), "TAKEN", "taken")
    seen = [documents.version]
    assert look() == ["command"]
    assert "starting 1 of 7" in see(read(documents, "runtime"))
    become_sole(place.root / WATCHDOG_LOCK, SystemClock(), "TAKEN", "taken")
    desk.record(GOAL, "goal_submitted", graph="tidy", seed=7, objective="Tidy.")
    desk.record(GOAL, "goal_compiled", nodes={"a": {"objective": "a"}}, accept=[], constraints=[])
    session = desk.submit("a")
    write_heartbeat(place.heartbeats, Heartbeat(target="panda", pid=os.getpid()))
    assert look() == ["command", "runtime", "goal", "plan", "worker"]
    seen.append(documents.version)
    desk.execute(session)
    assert look()[-1] == "motion"
    assert "starting" not in see(read(documents, "runtime"))
    assert len({version.stage for version in [*seen, documents.version]}) == 3, "each is news"


def test_an_answer_to_the_question_of_a_goal_is_news(documents):
    before = documents.refresh()
    folder = documents.workspace.answers_of("tidy-7")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "answer.json").write_text("{}")
    assert documents.refresh() != before
    assert "files" in next(each for each in PANELS if each.name == "questions").follows
