"""What was shown at an earlier record, from memory, from the journal or from its checkpoint."""

from contextlib import ExitStack, closing

import pytest

from phyagentos.store.follower import Follower
from phyagentos.store.journal import Entry
from phyagentos.store.ledger import Ledger
from phyagentos.store.views import page_history
from phyagentos.store.views.page_history import History
from phyagentos.store.views.sessions import render_page


@pytest.fixture
def open_history():
    with ExitStack() as opened:
        yield lambda lane: opened.enter_context(closing(History(lane)))


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


@pytest.mark.parametrize(
    ("count", "kept", "asked"),
    [
        pytest.param(10, 999, range(1, 11), id="what was rendered lately is remembered"),
        pytest.param(30, 20, (1, 10, 11, 30), id="the oldest renderings are let go and made anew"),
    ],
)
def test_renderings_are_kept_up_to_a_number(open_journal, submit, open_history, monkeypatch, count, kept, asked):
    monkeypatch.setattr(page_history, "PAGES_KEPT", kept)
    agent = open_journal()
    watched = open_history(agent.folder)
    for number in range(count):
        agent.commit([submit(f"s{number}")])
        watched.read_new()
        watched.build_page()
    begin = (lambda _: (Ledger(), Follower(agent.folder))) if kept < count else None
    monkeypatch.setattr(page_history, "_begin", begin)
    assert [len(watched.find_page(seq).shown) for seq in asked] == list(asked)
    assert len(watched._pages) == min(kept, count)


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
