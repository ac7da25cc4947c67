"""What a person writes into SESSIONS.md becomes a record, or is refused with line and reason; it is never lost."""

import re

import pytest

from phyagentos.protocol.sessions.session import Limits
from phyagentos.store.journal import Entry

from .conftest import make_submit

NEW = """## by-hand
```yaml
contract:
  objective: wave
  skill: wave
  target: panda
  accept: ["upright(bottle)"]
  scene: {name: tabletop/cubes_and_trays}
```
"""


def events(stand):
    records = stand.pens["runtime"].read_new()
    return [(record.id, record.ev, record.by) for record in records if record.side == "operator"]


def section(text, id):
    return text[text.index(f"## {id}\n") :].split("\n## ")[0]


def save(stand, text):
    stand.save(text)
    stand.settle()


@pytest.mark.parametrize(
    ("old", "new", "limits", "priority"),
    [
        ("timeout_s: 60.0", "timeout_s: 90", Limits(timeout_s=90.0), 0),
        ("priority: 0", "priority: 7", Limits(), 7),
        ("    timeout_s: 60.0\n", "    timeout_s: 5\n    # my note\n", Limits(timeout_s=5.0), 0),
    ],
)
def test_a_limit_or_the_priority_of_a_pending_session_is_amended(stand, old, new, limits, priority):
    stand.edit(old, new)
    stand.settle()

    assert events(stand) == [("a", "amend", "operator")]
    assert (stand.sessions["a"].contract.limits, stand.sessions["a"].contract.priority) == (limits, priority)
    assert ("# my note" in stand.rejected) == ("# my note" in new)


def test_a_session_is_cancelled_with_its_reason(stand):
    stand.commit("runtime", Entry("b", "claim"), Entry("b", "check"))
    stand.settle()
    text = stand.text.replace("state: pending\n", "state: cancelled\nreason: no more cubes\n", 1)
    save(stand, text.replace("state: preflight\n", "state: cancel\n", 1))

    assert events(stand) == [("a", "cancel", "operator"), ("b", "request_cancel", "operator")]
    assert (stand.sessions["a"].state, stand.sessions["a"].reason) == ("cancelled", "no more cubes")
    assert (stand.sessions["b"].state, stand.rejected) == ("cancelling", "")


@pytest.mark.parametrize("place", ["before the mark", "behind the mark"])
def test_a_section_that_is_added_submits_a_session(stand, place):
    mark = "<!-- end of view -->\n"
    save(stand, stand.text.replace(mark, NEW + mark) if place == "before the mark" else stand.text + NEW)

    assert events(stand) == [("by-hand", "submit", "operator")]
    status = stand.sessions["by-hand"]
    assert (status.state, status.asked_by, status.contract.goal) == ("pending", "operator", "")
    assert status.contract.scene.episode == "by-hand"
    assert stand.rejected == ""


def test_what_is_deleted_or_copied_asks_for_nothing_and_comes_back(stand):
    text = stand.text
    save(stand, text.replace(section(text, "a"), ""))
    save(stand, stand.text.replace("    timeout_s: 60.0\n", "", 1))
    save(stand, stand.text + section(stand.text, "a"))
    stand.file.write_bytes(b"\xef\xbb\xbf" + stand.text.replace("\n", "\r\n").encode())
    stand.settle()

    assert events(stand) == []
    assert stand.text.count("## a\n") == 1
    assert stand.text.count("timeout_s: 60.0") == text.count("timeout_s: 60.0")
    assert stand.rejected == ""


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("state: pending", "state: succeeded", r"state: a state follows from records, and a verdict from evidence"),
        ("skill: pick_and_place", "skill: wave", r"contract.skill: a contract stands as it was submitted"),
        ("timeout_s: 60.0", "timeout_s: soon", r"SESSIONS.md:\d+:\d+: INVALID_VALUE: found 'soon'"),
        ("timeout_s: 60.0", "timeout_s: -1", r"> 0"),
        ("timeout_s: 60.0", "timeout_s: .inf", r"< 1"),
        ("timeout_s: 60.0", "timout_s: 6", r"Did you mean 'timeout_s'\?"),
        ("priority: 0", "priority: high", r"INVALID_VALUE: found 'high'"),
        ("priority: 0", "priority: true", r"INVALID_VALUE: found True"),
        ("asked_by: agent", "asked_by: me", r"asked_by: this comes from the journal"),
        ("  limits:\n", "  limits: {{\n", r"SYNTAX"),
        ("# Sessions\n", "# My sessions\n", r"words and comments are not kept"),
        ("- **State:** pending", "- **State:** stuck?", r"words and comments are not kept"),
    ],
)
def test_an_edit_that_cannot_be_taken_is_refused_word_for_word(stand, old, new, reason):
    stand.edit(old, new)
    stand.settle()

    assert events(stand) == []
    assert re.search(rf"SESSIONS.md:\d+\n.*\*\*Refused:\*\* .*{reason}", stand.rejected, re.DOTALL), stand.rejected
    assert new.strip("\n") in stand.rejected
    assert "**Possible:**" in stand.rejected
    assert "> **Refused:** `SESSIONS.md:" in stand.text


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (
            "objective: wave",
            "objectiv: wave",
            r"SESSIONS.md:\d+:3: UNKNOWN_NAME \(key\): found 'objectiv'.*Did you mean",
        ),
        ('"upright(bottle)"', '"upright(bottle"', r"SYNTAX.*column"),
        ('"upright(bottle)"', "", r"at least one predicate"),
        ("  target: panda\n", "", r"MISSING_VALUE.*'target'"),
        ("contract:\n", "contract:\n  goal: tidy-7\n", r"NOT_PERMITTED.*it belongs to the agent"),
        ("contract:\n", "contract:\n  id: other\n", r"INVALID_VALUE.*'by-hand'"),
        ("contract:\n", "contract:\n  limits: {stall_s: 0}\n", r"> 0"),
        ("contract:\n", "contract:\n  strategy: {speed: 0}\n", r"a speed greater than 0"),
        ("contract:\n", "state: running\ncontract:\n", r"only 'contract', found state"),
        ("## by-hand", "## ../../etc", r"INVALID_VALUE"),
        ("```yaml\n", "", r"no YAML block that is closed"),
        ("objective: wave", "objective: !!bool x", r"SYNTAX"),
    ],
)
def test_a_new_section_that_is_no_contract_is_refused_with_its_place(stand, old, new, reason):
    save(stand, stand.text + NEW.replace(old, new))

    assert events(stand) == []
    assert re.search(reason, stand.rejected, re.DOTALL), stand.rejected
    assert NEW.replace(old, new) in stand.rejected


@pytest.mark.parametrize(
    ("entry", "side", "old", "new", "reason"),
    [
        (
            Entry("a", "amend", {"priority": 4}),
            "operator",
            "priority: 0",
            "priority: 5",
            "priority was 0 where you began and is 4 by now",
        ),
        (Entry("a", "claim"), "runtime", "timeout_s: 60.0", "timeout_s: 61", "asked for 'amend' in state 'claimed'"),
        (Entry("a", "reject", {}), "runtime", "state: pending", "state: cancelled", "the state is final"),
        (make_submit("by-hand"), "agent", "<!-- end of view -->\n", NEW, "asked for 'submit' in state 'pending'"),
    ],
)
def test_an_edit_that_came_too_late_is_refused_with_the_present_state(stand, entry, side, old, new, reason):
    text = stand.text.replace(old, new, 1)
    stand.commit(side, entry)
    stand.settle(1)
    save(stand, text + ("<!-- end of view -->\n" if old.startswith("<!") else ""))

    assert len(events(stand)) == (side == "operator")
    assert reason in stand.rejected
    assert new in stand.rejected


def test_two_sections_of_one_name_are_refused(stand):
    save(stand, stand.text + NEW + NEW.replace("wave", "point"))

    assert events(stand) == []
    assert stand.rejected.count("two sections are called by-hand") == 2


def test_an_edit_of_an_old_rendering_is_taken_into_the_present(stand, submit):
    text = stand.text
    for number in range(30):
        stand.commit("agent", submit(f"s{number}"))
        stand.settle(1)
    save(stand, text.replace("priority: 0", "priority: 5", 1))
    assert (stand.sessions["a"].contract.priority, stand.rejected) == (5, "")


def test_an_edit_of_an_unknown_rendering_is_refused_as_a_whole(stand):
    for view in ("view: 999999", "views: 1"):
        save(stand, re.sub("view: \\d+", view, stand.text, count=1).replace("priority: 0", "priority: 5", 1))

    assert "at record 2, does not show what was rendered at record 999999" in stand.rejected
    assert "does not show which rendering it was made from" in stand.rejected
    assert stand.rejected.count("priority: 5") == 2
    assert events(stand) == []


def test_a_save_that_is_given_up_is_refused_unless_it_only_lacks_its_end(stand):
    save(stand, stand.text[:-40])
    assert stand.rejected == ""

    save(stand, stand.text.replace("priority: 0", "priority: 5", 1)[:-40])
    stand.settle(8)
    assert "the save was not finished" in stand.rejected
    assert "priority: 5" in stand.rejected
    assert events(stand) == []


def test_the_note_of_a_refusal_goes_after_a_while(stand):
    stand.edit("state: pending", "state: succeeded")
    stand.settle()
    assert "> **Refused:**" in stand.text
    save(stand, stand.text)
    assert stand.rejected.count("**Refused:**") == 1

    stand.clock.advance(601)
    save(stand, stand.text)
    assert "> **Refused:**" not in stand.text
