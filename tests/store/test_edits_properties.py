"""The merge, driven at random: what was rendered asks for nothing, what was written is recorded or refused."""

import re

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended, Execution, Limits
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.truth import Truth
from phyagentos.store.edits.merge import merge
from phyagentos.store.edits.reading import decode, read_sheet
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.store.views.sessions import END_MARK, render_sessions
from phyagentos.testing import ManualClock

FAST = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
TOKEN = "zqxw"
TEXTS = st.text(max_size=40) | st.sampled_from(["## a\n```yaml\nx", "<!-- end of view -->", "a # b", "---\n", "`````"])
IDS = ("a", "b", "c")
NEW = (
    '## {id}\n```yaml\ncontract: {{objective: o, skill: s, target: t, accept: ["on(a, b)"], scene: {{name: s}}}}\n```\n'
)


class Bench:
    """A journal with three sessions, and its fold."""

    def __init__(self, root, submit, objective="o") -> None:
        self.journals = {
            side: Journal(root, side=side, by=side.value, clock=ManualClock(), durable=False) for side in Side
        }
        self.ledger = Ledger()
        self.commit(Side.AGENT, *(submit(id, objective=objective, parameters={"text": objective}) for id in IDS))

    def commit(self, side, *entries):
        self.journals[side].commit(list(entries))
        for record in self.journals[Side.AGENT].read_new():
            self.ledger.apply(record)

    def merge(self, edited, base):
        return merge(read_sheet(edited), read_sheet(base), self.ledger.sessions)

    def close(self):
        for journal in self.journals.values():
            journal.close()


@pytest.fixture
def open_bench(tmp_path_factory, submit):
    opened = []

    def open_one(objective="o"):
        opened.append(Bench(tmp_path_factory.mktemp("lane"), submit, objective))
        return opened[-1]

    yield open_one
    for bench in opened:
        bench.close()


def advance(bench, id, steps, text):
    execution = Execution(ended=Ended.SKILL_FAILED, evidence="e", message=text, outputs={"said": text})
    attempt = Attempt(
        verdict=Verdict.FAILURE,
        reason=text,
        criteria=(Criterion(text=text, kind="accept", truth=Truth.FALSE, because=text),),
    )
    story = [
        (Side.RUNTIME, Entry(id, "claim")),
        (Side.RUNTIME, Entry(id, "check")),
        (Side.RUNTIME, Entry(id, "start", epoch=1)),
        (Side.RUNTIME, Entry(id, "halt")),
        (Side.RUNTIME, Entry(id, "finish", {"execution": execution}, 1)),
        (Side.AGENT, Entry(id, "verify")),
        (Side.AGENT, Entry(id, "refuse", {"attempt": attempt})),
    ]
    for side, entry in story[:steps]:
        bench.commit(side, entry)


@FAST
@given(objective=TEXTS, steps=st.tuples(*[st.integers(0, 7)] * 3), text=TEXTS)
def test_what_was_rendered_asks_for_nothing(open_bench, objective, steps, text):
    bench = open_bench(objective)
    for id, count in zip(IDS, steps, strict=True):
        advance(bench, id, count, text)
    rendered = render_sessions(bench.ledger)
    sheet = read_sheet(decode(rendered.encode()))

    assert {section.name for section in sheet.sections} == set(IDS)
    assert sheet.view == bench.ledger.seq
    assert bench.merge(rendered, rendered) == bench.merge(rendered.replace("\n", " \n"), rendered)
    result = bench.merge(rendered, rendered)
    assert (result.accepted, result.refused) == ((), ())


LIMITS = st.sampled_from(Limits.__struct_fields__)
SECONDS = st.floats(0.001, 1e6).filter(lambda value: value not in {60.0, 120.0, 3600.0, 10.0})
CHANGES = st.one_of(
    st.tuples(st.just("limit"), st.sampled_from(IDS), LIMITS, SECONDS),
    st.tuples(st.just("priority"), st.sampled_from(IDS), st.just(""), st.integers(1, 999)),
    st.tuples(st.just("cancel"), st.sampled_from(IDS), st.just(""), st.just("cancelled")),
    st.tuples(
        st.just("submit"), st.from_regex(r"[A-Za-z][A-Za-z0-9._-]{1,20}", fullmatch=True), st.just(""), st.just("")
    ),
)


def write(text, change):
    """Make one change in a document, as a person would."""
    kind, id, field, value = change
    if kind == "submit":
        return text.replace(END_MARK, NEW.format(id=id) + END_MARK)
    key = {"limit": field, "priority": "priority", "cancel": "state"}[kind]
    begin = text.index(f"## {id}\n")
    end = text.index("\n```\n", begin)
    block = re.sub(
        rf"^( *{key}): .*$", rf"\g<1>: {value!r}".replace("'", ""), text[begin:end], count=1, flags=re.MULTILINE
    )
    return text[:begin] + block + text[end:]


def expect(change):
    kind, id, field, value = change
    match kind:
        case "limit":
            return (id, "amend", {"limits": {field: value}})
        case "priority":
            return (id, "amend", {"priority": value})
        case "cancel":
            return (id, "cancel", {"reason": "asked for by hand"})
    return (id, "submit", None)


@FAST
@given(change=CHANGES)
def test_a_legal_edit_becomes_exactly_its_record(open_bench, change):
    bench = open_bench()
    base = render_sessions(bench.ledger)
    result = bench.merge(write(base, change), base)
    (accepted,) = result.accepted
    id, ev, body = expect(change)

    assert result.refused == ()
    assert (accepted.entry.id, accepted.entry.ev) == (id, ev)
    assert body is None or accepted.entry.body == body
    bench.commit(Side.OPERATOR, accepted.entry)
    again = bench.merge(write(base, change), base)
    assert (again.accepted, again.refused) == ((), ())


@FAST
@given(first=CHANGES, second=CHANGES)
def test_disjoint_edits_of_one_rendering_commute(open_bench, first, second):
    if first[1] == second[1] and (first[0] == second[0] != "limit" or "cancel" in {first[0], second[0]}):
        return
    if first[:3] == second[:3]:
        return
    outcomes = []
    for order in ((first, second), (second, first)):
        bench = open_bench()
        base = render_sessions(bench.ledger)
        for change in order:
            for accepted in bench.merge(write(base, change), base).accepted:
                bench.commit(Side.OPERATOR, accepted.entry)
        outcomes.append({id: (status.contract, status.state) for id, status in bench.ledger.sessions.items()})
    together = open_bench()
    base = render_sessions(together.ledger)
    for accepted in together.merge(write(write(base, first), second), base).accepted:
        together.commit(Side.OPERATOR, accepted.entry)
    outcomes.append({id: (status.contract, status.state) for id, status in together.ledger.sessions.items()})

    assert outcomes[0] == outcomes[1] == outcomes[2]


@pytest.mark.parametrize("kind", ["new line", "end of line", "begin of line", "instead"])
def test_every_word_that_somebody_adds_anywhere_is_found_again(open_bench, kind):
    bench = open_bench()
    advance(bench, "b", 5, "it slipped")
    base = render_sessions(bench.ledger)
    lines = base.split("\n")
    whole = 0
    for index, line in enumerate(lines):
        changed = {
            "new line": [TOKEN, line],
            "end of line": [f"{line} {TOKEN}"],
            "begin of line": [f"{TOKEN} {line}"],
            "instead": [TOKEN],
        }[kind]
        edited = "\n".join([*lines[:index], *changed, *lines[index + 1 :]])
        if read_sheet(edited).view is None:
            whole += 1  # refused as a whole, see test_edits
            continue
        result = bench.merge(edited, base)
        kept = "".join(each.text for each in result.refused) + str([each.entry.body for each in result.accepted])

        assert TOKEN in kept, (index, line)
        assert all(each.reason and each.possible for each in result.refused)
    assert whole <= 3


@settings(FAST, max_examples=150)
@given(data=st.data())
def test_garbage_never_raises_and_never_changes_a_session_by_itself(open_bench, data):
    bench = open_bench()
    base = render_sessions(bench.ledger)
    edited = base
    for _ in range(data.draw(st.integers(1, 4))):
        begin = data.draw(st.integers(0, len(edited)))
        end = data.draw(st.integers(begin, min(len(edited), begin + 200)))
        piece = data.draw(
            st.sampled_from(["", "```\n", "## a\n", "contract:", "[", "{{", "&a *a", "!!binary x", "\x00"]) | TEXTS
        )
        edited = edited[:begin] + piece + edited[end:]
    result = bench.merge(decode(edited.encode("utf-8", "surrogatepass")), base)

    assert all(each.entry.ev in {"submit", "amend", "cancel"} for each in result.accepted)
    msgspec.to_builtins([each.entry for each in result.accepted])


@given(data=st.binary(max_size=400))
def test_any_bytes_can_be_read(data):
    sheet = read_sheet(decode(data))

    assert merge(sheet, read_sheet(""), {}).accepted == ()
