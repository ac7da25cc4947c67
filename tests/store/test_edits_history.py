"""What was shown at an earlier record, from memory, from the journal or from its checkpoint."""

import pytest

from phyagentos.store.follower import Follower
from phyagentos.store.journal import Entry
from phyagentos.store.ledger import Ledger
from phyagentos.store.views import page_history
from phyagentos.store.views.page_history import History
from phyagentos.store.views.sessions import render_page


@pytest.fixture
def open_history():
    opened = []

    def open_one(lane, **options):
        opened.append(History(lane, **options))
        return opened[-1]

    yield open_one
    for each in opened:
        each.close()


@pytest.fixture
def story(open_journal, submit):
    """Sixty sessions; after each record, what SESSIONS.md showed."""
    agent = open_journal()
    texts, watched = {}, History(agent.folder)
    for number in range(60):
        for entry in (submit(f"s{number}"), Entry(f"s{number}", "cancel")):
            agent.commit([entry])
            watched.read_new()
            texts[watched.ledger.seq] = render_page(watched.build_page())
    watched.close()
    return agent.folder, texts


def test_every_earlier_rendering_is_found_again(story, open_history):
    lane, texts = story
    late = open_history(lane)
    late.read_new()

    for seq in (1, 2, 59, 119, 120):
        assert render_page(late.find_page(seq)) == texts[seq]


def test_what_was_rendered_lately_is_remembered(open_journal, submit, open_history, monkeypatch):
    agent = open_journal()
    watched = open_history(agent.folder)
    for number in range(10):
        agent.commit([submit(f"s{number}")])
        watched.read_new()
        watched.build_page()
    monkeypatch.setattr(page_history, "_begin", None)

    assert [len(watched.find_page(seq).shown) for seq in range(1, 11)] == list(range(1, 11))


def test_the_oldest_renderings_are_let_go(open_journal, submit, open_history, monkeypatch):
    monkeypatch.setattr(page_history, "PAGES_KEPT", 20)
    agent = open_journal()
    watched = open_history(agent.folder)
    for number in range(30):
        agent.commit([submit(f"s{number}")])
        watched.read_new()
        watched.build_page()
    monkeypatch.setattr(page_history, "_begin", lambda _: (Ledger(), Follower(agent.folder)))

    assert [len(watched.find_page(seq).shown) for seq in (1, 10, 11, 30)] == [1, 10, 11, 30]
    assert len(watched._pages) == 20


@pytest.mark.slow
def test_a_record_that_is_still_to_come_is_not_told(story, open_history):
    lane, texts = story
    late = open_history(lane)
    late.read_new()

    assert late.find_page(max(texts) + 1) is None
    assert late.find_page(0).shown == []


@pytest.mark.slow
def test_a_large_journal_is_read_from_its_checkpoint(story, open_history, open_journal, monkeypatch):
    lane, texts = story
    monkeypatch.setattr(page_history, "SMALL_BYTES", 0)
    journal = open_journal(by="upkeep")
    ledger = journal.open_ledger()
    assert ledger.seq == 120
    late = open_history(lane)
    late.read_new()

    assert render_page(late.find_page(120)) == texts[120]
    page = late.find_page(30)
    assert page is None or render_page(page) == texts[30]
