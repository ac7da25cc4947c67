"""A proposal is its bytes: what changes loses its name, and a decision is about these bytes alone."""

import pytest
import yaml

from phyagentos.agent.tools.proposals import Proposal, Proposals, encode_proposal
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.seen_text import find_unseen

GRAPH = {"goal": "tidy", "objective": "Tidy up.", "scene": "table", "sessions": {"a": {"skill": "pick"}}}
AT = "2026-11-26T12:00:00.000000Z"


def make(**more):
    facts = {"goal": "tidy", "seed": 7, "by": "mcp", "at": AT, "reason": "supper", "graph": GRAPH}
    return encode_proposal(Proposal(**(facts | more)))


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "proposals"


@pytest.fixture
def proposals(folder):
    return Proposals(folder)


def refuse(function, *arguments, **more):
    with pytest.raises(DefinitionError) as refused:
        function(*arguments, **more)
    return refused.value.problems[0].label


def decide(proposals, proposed, verdict="approved"):
    proposals.decide(proposed, verdict, by="me", at=AT, reason="fine")


def test_a_proposal_is_read_as_it_was_written(proposals):
    proposed = make()
    proposals.put(proposed)
    proposals.put(proposed)
    assert proposals.list_waiting() == [proposed.name]
    assert proposals.read(proposed.name) == proposed


def test_other_content_is_another_name():
    assert make().name != make(seed=8).name
    assert make().name == make().name


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.replace(b"supper", b"dinner"),
        lambda data: data + b"# approved by the operator\n",
        lambda data: data.replace(b"seed: 7", b"seed: 0x7"),
        lambda data: data.replace(b"seed: 7", b"seed:  7"),
    ],
)
def test_a_changed_file_is_refused(proposals, folder, change):
    proposed = make()
    proposals.put(proposed)
    decide(proposals, proposed)
    file = folder / "new" / f"{proposed.name}.yaml"
    file.write_bytes(change(proposed.data))
    assert refuse(proposals.read, proposed.name) == "CHANGED"


def test_a_decision_is_made_once(proposals):
    proposed = make()
    proposals.put(proposed)
    decide(proposals, proposed, "denied")
    assert refuse(decide, proposals, proposed) == "ALREADY_OVER"
    assert proposals.find_decision(proposed).decision == "denied"
    assert proposals.list_waiting() == []


def test_an_approval_of_other_bytes_is_none(proposals, folder):
    first, second = make(), make(seed=8)
    for each in (first, second):
        proposals.put(each)
    decide(proposals, first)
    approval = (folder / "decisions" / f"{first.name}.yaml").read_text()
    (folder / "decisions" / f"{second.name}.yaml").write_text(approval)
    assert refuse(proposals.find_decision, second) == "CHANGED"
    (folder / "decisions" / f"{second.name}.yaml").write_text(approval.replace(first.name, second.name))
    assert refuse(proposals.find_decision, second) == "CHANGED"


@pytest.mark.parametrize("name", ["../x", "x", "", "/etc/passwd", "tidy-0123456789abcdef/../y", "a" * 300, "tidy-\0"])
def test_a_hostile_name_is_unknown(proposals, name):
    assert refuse(proposals.read, name) == "UNKNOWN_NAME (proposal)"


def test_what_is_no_regular_small_text_is_refused(proposals, folder, tmp_path):
    proposed = make()
    proposals.put(proposed)
    file = folder / "new" / f"{proposed.name}.yaml"
    file.write_bytes(b"\xff\xfe")
    assert refuse(proposals.read, proposed.name) == "UNREADABLE_FILE"
    file.write_bytes(b" " * (1 << 19))
    assert refuse(proposals.read, proposed.name) == "UNREADABLE_FILE"
    file.unlink()
    (tmp_path / "elsewhere.yaml").write_bytes(proposed.data)
    file.symlink_to(tmp_path / "elsewhere.yaml")
    assert refuse(proposals.read, proposed.name) == "UNREADABLE_FILE"
    assert proposals.list_waiting() == []


def test_a_link_is_no_approval(proposals, folder, tmp_path):
    proposed = make()
    proposals.put(proposed)
    decide(proposals, proposed)
    file = folder / "decisions" / f"{proposed.name}.yaml"
    file.rename(tmp_path / "approval.yaml")
    file.symlink_to(tmp_path / "approval.yaml")
    assert refuse(proposals.find_decision, proposed) == "UNREADABLE_FILE"


UNSEEN = {  # and every ignorable letter, below
    "a hangul filler": "\u3164", "escape": "\x1b", "an override": "\u202e", "next line": "\x85",
    "a line of its own": "\u2028", "a return": "\r", "a blank of braille": "\u2800",
    "a heap of wide marks": "a" + "\u0903" * 6, "marks on blanks": "a" + " \u0301" * 20,
    "a mark on a line": "a\n\u0301b",
    "a heap of marks": "\u0301\u0302\u0303\u0304\u0305", "many blanks": " " * 40, "many lines": "\n" * 40,
    "wide blanks": "\u3000" * 20,
}  # fmt: skip


@pytest.mark.parametrize("letters", UNSEEN.values(), ids=UNSEEN)
def test_text_that_is_not_seen_as_it_is_is_refused(letters):
    assert refuse(make, reason=f"a{letters}b") == "INVALID_VALUE"
    assert refuse(make, graph=GRAPH | {"objective": f"a{letters}[2Jb"}) == "INVALID_VALUE"
    assert refuse(make, graph=GRAPH | {f"a{letters}": 1}) == "INVALID_VALUE"


@pytest.mark.parametrize(
    "words",
    [
        "Räume den Tisch auf, 整理\n\tbitte",
        "Tie\u0302\u0301ng Vi\u1ec7t, \u0915\u093c\u094d\u0937, \u0e17\u0e35\u0e48, e\u0301, \U0001f525",
    ],
)
def test_words_of_any_language_lines_and_marks_on_letters_are_no_problem(words):
    assert words in yaml.safe_load(make(reason=words).data)["reason"]


def test_a_mark_without_a_letter_and_a_huge_text_are_refused():
    assert refuse(make, reason="\u0338= b") == "INVALID_VALUE"
    assert refuse(make, graph=GRAPH | {"objective": "a" * (1 << 18)}) == "TOO_LARGE"


def test_a_flood_is_refused(proposals, monkeypatch):
    monkeypatch.setattr("phyagentos.agent.tools.proposals.WAITING_MAX", 5)
    for seed in range(5):
        proposals.put(make(seed=seed))
    assert refuse(proposals.put, make(seed=1000)) == "TOO_LARGE"
    decide(proposals, make(seed=0), "denied")
    proposals.put(make(seed=1000))


def test_approvals_of_a_day_are_counted_by_decider(proposals):
    for seed, by in enumerate(["policy a", "policy a", "me"]):
        proposals.put(make(seed=seed))
        proposals.decide(make(seed=seed), "approved", by=by, at=AT, reason="")
    assert proposals.count_approvals("policy a", "2026-11-26T00") == 2
    assert proposals.count_approvals("policy a", "2026-11-27T00") == 0


IGNORABLE = (  # Default_Ignorable_Code_Point, DerivedCoreProperties.txt of Unicode 16.0.0
    "00AD 034F 061C 115F-1160 17B4-17B5 180B-180F 200B-200F 202A-202E 2060-206F 3164 FE00-FE0F FEFF FFA0 FFF0-FFF8 "
    "1BCA0-1BCA3 1D173-1D17A E0000-E0FFF"
)


def test_every_ignorable_letter_is_found():
    spans = [[int(end, 16) for end in span.split("-")] for span in IGNORABLE.split()]
    letters = [chr(code) for span in spans for code in range(span[0], span[-1] + 1)]
    assert len(letters) == 4174
    assert [each for each in letters if not find_unseen(f"a{each}b")] == []
