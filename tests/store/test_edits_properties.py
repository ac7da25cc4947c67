"""Edits at random: what was rendered asks for nothing; what was written is a record or in the rejected file."""

import re
from contextlib import ExitStack, closing

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.protocol.sessions.session import Ended, Execution, Limits
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.edits.sections import compare
from phyagentos.store.journal import Entry
from phyagentos.store.shared_file import decode
from phyagentos.store.views.page_history import History
from phyagentos.store.views.sessions import END_MARK
from phyagentos.testing import ManualClock

from .edit_stand import EditStand

FAST = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
TOKEN = "zqxw"
TEXTS = st.text(max_size=40) | st.sampled_from(["## a\n```yaml\nx", "<!-- end of view -->", "a # b", "---\n", "`````"])
IDS = ("a", "b", "c")
NEW = (
    '## {id}\n```yaml\ncontract: {{objective: o, skill: s, target: t, accept: ["on(a, b)"], scene: {{name: s}}}}\n```\n'
)


class Bench(EditStand):
    """A workspace with three sessions, and what it renders."""

    def __init__(self, root, submit, objective="o") -> None:
        super().__init__(root, ManualClock())
        self.commit("agent", *(submit(id, objective=objective, parameters={"text": objective}) for id in IDS))
        self.history = History(self.pens["agent"].folder)

    def render(self):
        self.history.read_new()
        return self.history.render(self.history.build_page())

    def take(self, text):
        return self.edits.take_text(decode(text.encode("utf-8", "surrogatepass")), self.history)

    def close(self):
        self.history.close()
        super().close()


@pytest.fixture
def open_bench(tmp_path_factory, submit):
    with ExitStack() as opened:
        yield lambda objective="o": opened.enter_context(
            closing(Bench(tmp_path_factory.mktemp("w") / "w", submit, objective))
        )


@pytest.fixture
def bench(open_bench):
    return open_bench()


def advance(bench, id, steps, text):
    execution = Execution(ended=Ended.SKILL_FAILED, evidence="e", message=text, outputs={"said": text})
    criterion = Criterion(text=text, kind="accept", truth=Truth.FALSE, because=text)
    attempt = Attempt(verdict=Verdict.FAILURE, reason=text, criteria=(criterion,))
    story = [
        ("runtime", Entry(id, "claim")),
        ("runtime", Entry(id, "check")),
        ("runtime", Entry(id, "start", epoch=1)),
        ("runtime", Entry(id, "halt")),
        ("runtime", Entry(id, "finish", {"execution": execution}, 1)),
        ("agent", Entry(id, "verify")),
        ("agent", Entry(id, "refuse", {"attempt": attempt})),
    ]
    for side, entry in story[:steps]:
        bench.commit(side, entry)


@pytest.mark.slow
@FAST
@given(objective=TEXTS, steps=st.tuples(*[st.integers(0, 7)] * 3), text=TEXTS)
def test_what_was_rendered_asks_for_nothing(open_bench, objective, steps, text):
    bench = open_bench(objective)
    for id, count in zip(IDS, steps, strict=True):
        advance(bench, id, count, text)
    rendered = bench.render()

    assert not bench.take(rendered)
    assert not bench.take(rendered.replace("\n", " \n"))
    assert {edit.section.name for edit in compare(rendered, "", "S.md")} == {"", *IDS}


SECONDS = st.floats(0.001, 1e6).filter(lambda value: value not in {60.0, 120.0, 3600.0, 10.0, 20.0, 90.0})
CHANGES = st.one_of(
    st.tuples(st.just("amend"), st.sampled_from(IDS), st.sampled_from(Limits.__struct_fields__), SECONDS),
    st.tuples(st.just("amend"), st.sampled_from(IDS), st.just("priority"), st.integers(1, 999)),
    st.tuples(st.just("cancel"), st.sampled_from(IDS), st.just("state"), st.just("cancelled")),
    st.tuples(
        st.just("submit"), st.from_regex(r"[A-Za-z][A-Za-z0-9._-]{1,20}", fullmatch=True), st.just(""), st.just("")
    ),
)


def write(text, change):
    """Make one change in a document, as a person would."""
    kind, id, key, value = change
    if kind == "submit":
        return text.replace(END_MARK, NEW.format(id=id) + END_MARK)
    begin = text.index(f"## {id}\n")
    end = text.index("\n```\n", begin)
    line = rf"\g<1>: {value!r}".replace("'", "")
    return text[:begin] + re.sub(rf"^( *{key}): .*$", line, text[begin:end], count=1, flags=re.MULTILINE) + text[end:]


@pytest.mark.slow
@FAST
@given(change=CHANGES)
def test_a_legal_edit_becomes_exactly_its_record(open_bench, change):
    bench = open_bench()
    kind, id, key, value = change
    text = write(bench.render(), change)
    outcome = bench.take(text)

    (entry,) = outcome.recorded
    assert outcome.refused == []
    assert (entry.id, entry.ev) == (id, kind)
    amended = {"priority": value} if key == "priority" else {"limits": {key: value}}
    assert kind != "amend" or entry.body == amended
    assert not bench.take(text)


@pytest.mark.parametrize("kind", ["new line", "end of line", "begin of line", "instead"])
def test_every_word_that_is_added_anywhere_is_found_again(open_bench, kind):
    bench = open_bench()
    advance(bench, "b", 5, "it slipped")
    lines = bench.render().split("\n")
    for index, line in enumerate(lines):
        word = f"{TOKEN}{index}"
        changed = {
            "new line": [word, line],
            "end of line": [f"{line} {word}"],
            "begin of line": [f"{word} {line}"],
            "instead": [word],
        }[kind]
        outcome = bench.take("\n".join([*lines[:index], *changed, *lines[index + 1 :]]))

        assert word in bench.rejected + str([entry.body for entry in outcome.recorded]), (index, line)
        assert all(each.reason and each.possible for each in outcome.refused)


@pytest.mark.slow
@settings(FAST, max_examples=120)
@given(data=st.data())
def test_garbage_never_raises_and_each_word_of_it_is_recorded_or_kept(bench, data):
    edited = bench.render()
    for number in range(data.draw(st.integers(1, 4))):
        begin = data.draw(st.integers(0, len(edited)))
        end = data.draw(st.integers(begin, min(len(edited), begin + 200)))
        piece = data.draw(
            st.sampled_from(["", "```\n", "## a\n", "contract:", "[", "{{", "&a *a", "!!binary x", "\x00"]) | TEXTS
        )
        edited = f"{edited[:begin]}{piece} {TOKEN}{number}\n{edited[end:]}"
    outcome = bench.take(edited)

    assert all(entry.ev in {"submit", "amend", "cancel"} for entry in outcome.recorded)
    kept = bench.rejected + str([entry.body for entry in outcome.recorded])
    assert [word for word in re.findall(rf"{TOKEN}\d", edited) if word not in kept] == []


@FAST
@given(data=st.binary(max_size=400))
def test_any_bytes_are_kept(bench, data):
    text = decode(data)

    assert bench.edits.take_text(text, bench.history).recorded == []
    assert not text.strip() or text.rstrip() in bench.rejected
