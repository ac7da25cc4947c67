"""What a person writes into SESSIONS.md becomes a record, or is refused with line and reason; it is never lost."""

import re

import pytest

from phyagentos.protocol.sessions.lifecycle import FINAL_STATES
from phyagentos.protocol.sessions.session import Limits
from phyagentos.store.journal import Entry

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
    return [(record.id, record.ev, record.by) for record in stand.runtime.read_new() if record.side == "operator"]


def section(text, id):
    return text[text.index(f"## {id}\n") :].split("\n## ")[0]


def test_an_untouched_file_asks_for_nothing(stand):
    stand.save(stand.text)
    stand.settle()

    assert events(stand) == []
    assert stand.rejected == ""


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
    assert new.split("\n")[0].strip().split(": ")[1] in section(stand.text, "a")
    assert ("# my note" in stand.rejected) == ("# my note" in new)


def test_a_session_is_cancelled_with_its_reason(stand, submit):
    stand.commit("runtime", Entry("b", "claim"))
    stand.commit("runtime", Entry("b", "check"))
    stand.settle()
    text = stand.text.replace("state: pending\n", "state: cancelled\nreason: no more cubes\n", 1)
    stand.save(text.replace("state: preflight\n", "state: cancel\n", 1))
    stand.settle()

    assert events(stand) == [("a", "cancel", "operator"), ("b", "request_cancel", "operator")]
    assert (stand.sessions["a"].state, stand.sessions["a"].reason) == ("cancelled", "no more cubes")
    assert stand.sessions["b"].state == "cancelling"
    assert stand.rejected == ""


@pytest.mark.parametrize("place", ["before the mark", "behind the mark"])
def test_a_section_that_is_added_submits_a_session(stand, place):
    mark = "<!-- end of view -->\n"
    stand.save(stand.text.replace(mark, NEW + mark) if place == "before the mark" else stand.text + NEW)
    stand.settle()

    assert events(stand) == [("by-hand", "submit", "operator")]
    status = stand.sessions["by-hand"]
    assert (status.state, status.asked_by, status.contract.goal) == ("pending", "operator", "")
    assert status.contract.scene.episode == "by-hand"
    assert "**Asked:** wave (`wave` on `panda`; no arguments), by operator" in stand.text
    assert stand.rejected == ""


def test_saving_the_same_buffer_again_changes_nothing_more(stand):
    text = stand.text.replace("priority: 0", "priority: 3", 1) + NEW
    for _ in range(3):
        stand.save(text)
        stand.settle()

    assert len(events(stand)) == 2
    assert stand.rejected == ""


def test_what_is_deleted_asks_for_nothing_and_comes_back(stand):
    text = stand.text
    stand.save(text.replace(section(text, "a"), "").replace(section(text, "b")[:-40], ""))
    stand.settle()

    assert events(stand) == []
    assert "## a\n" in stand.text


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("state: pending", "state: succeeded", r"state: a state follows from records, and a verdict from evidence"),
        ("skill: pick_and_place", "skill: wave", r"contract.skill: a contract stands as it was submitted"),
        ("timeout_s: 60.0", "timeout_s: soon", r"contract.limits.timeout_s: SESSIONS.md:\d+:\d+: INVALID_VALUE"),
        ("timeout_s: 60.0", "timeout_s: -1", r"contract.limits.timeout_s: .*greater than 0"),
        ("timeout_s: 60.0", "timout_s: 6", r"contract.limits.timout_s: .*Did you mean 'timeout_s'\?"),
        ("priority: 0", "priority: high", r"contract.priority: found 'high'\.\n.*a whole number"),
        ("priority: 0", "priority: true", r"contract.priority: found True"),
        ("asked_by: mission", "asked_by: me", r"asked_by: this comes from the journal"),
        ("    timeout_s: 60.0\n", "", r"contract.limits.timeout_s: the line was deleted, which asks for nothing"),
        ("  limits:\n", "  limits: {{\n", r"YAML_SYNTAX"),
        ("# Sessions\n", "# My sessions\n", r"words and comments are not kept"),
        ("- **State:** pending", "- **State:** stuck?", r"words and comments are not kept"),
    ],
)
def test_an_edit_that_cannot_be_taken_is_refused_word_for_word(stand, old, new, reason):
    line = stand.text[: stand.text.index(old)].count("\n") + 1
    stand.edit(old, new)
    stand.settle()

    assert events(stand) == []
    assert re.search(rf"\*\*Refused:\*\* .*{reason}", stand.rejected, re.DOTALL), stand.rejected
    assert new.strip("\n") in stand.rejected
    assert "**Possible:**" in stand.rejected
    assert "> **Refused:** `SESSIONS.md:" in stand.text
    if old not in {"    timeout_s: 60.0\n", "  limits:\n"}:
        assert f" SESSIONS.md:{line}\n" in stand.rejected


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("objective: wave", "objectiv: wave", r"SESSIONS.md:\d+:3: UNKNOWN_KEY: found 'objectiv'.*Did you mean"),
        ('"upright(bottle)"', '"upright(bottle"', r"PREDICATE_SYNTAX.*column"),
        ("  target: panda\n", "", r"MISSING_KEY.*'target'"),
        ("contract:\n", "contract:\n  goal: tidy-7\n", r"NOT_BY_HAND.*it belongs to the agent"),
        ("contract:\n", "contract:\n  id: other\n", r"NAME_MISMATCH.*'other'"),
        ("contract:\n", "state: running\ncontract:\n", r"only 'contract', found state"),
        ("## by-hand", "## ../../etc", r"INVALID_ID"),
        ("```yaml\n", "", r"no YAML block that is closed"),
    ],
)
def test_a_new_section_that_is_no_contract_is_refused_with_its_place(stand, old, new, reason):
    stand.save(stand.text + NEW.replace(old, new))
    stand.settle()

    assert events(stand) == []
    assert re.search(reason, stand.rejected, re.DOTALL), stand.rejected
    assert NEW.replace(old, new) in stand.rejected


def test_words_around_a_new_section_are_kept_in_the_refused_file(stand):
    stand.save(stand.text + NEW.replace("```yaml", "Please be gentle.\n\n```yaml"))
    stand.settle()

    assert events(stand) == [("by-hand", "submit", "operator")]
    assert "Please be gentle." in stand.rejected


def test_a_field_that_changed_meanwhile_is_refused_with_both_values(stand):
    text = stand.text
    stand.commit("operator", Entry("a", "amend", {"priority": 4, "limits": {"queue_s": 9.0}}))
    stand.settle()
    stand.save(text.replace("priority: 0", "priority: 5", 1).replace("timeout_s: 60.0", "timeout_s: 61", 1))
    stand.settle()

    assert "contract.priority: it was 0 where you began, is 4 by now, and you want 5" in stand.rejected
    contract = stand.sessions["a"].contract
    assert (contract.priority, contract.limits) == (4, Limits(timeout_s=61.0, queue_s=9.0))


def test_limits_of_a_claimed_session_are_fixed(stand):
    text = stand.text
    stand.commit("runtime", Entry("a", "claim"))
    line = text[: text.index("timeout_s: 60.0")].count("\n") + 1
    stand.save(text.replace("timeout_s: 60.0", "timeout_s: 61", 1))
    stand.settle()

    assert f" SESSIONS.md:{line}\n" in stand.rejected
    assert "objective" not in stand.rejected
    assert "session a is claimed; limits and priority change only while it is pending" in stand.rejected
    assert "timeout_s: 61" in stand.rejected


def test_a_final_session_cannot_be_cancelled(stand):
    text = stand.text
    stand.commit("runtime", Entry("a", "reject", {"reason": "no"}))
    stand.save(text.replace("state: pending", "state: cancelled", 1))
    stand.settle()

    assert "session a is rejected, which is final" in stand.rejected
    assert stand.sessions["a"].state in FINAL_STATES


def test_two_sections_of_one_name_are_refused(stand):
    stand.save(stand.text + NEW + NEW.replace("wave", "point"))
    stand.settle()

    assert events(stand) == []
    assert stand.rejected.count("two sections are called by-hand") == 2


def test_a_copied_section_without_a_new_name_asks_for_nothing(stand):
    stand.save(stand.text + section(stand.text, "a"))
    stand.settle()

    assert events(stand) == []
    assert stand.rejected == ""


def test_a_session_that_exists_is_not_submitted_again_as_another(stand):
    stand.commit("agent", Entry("by-hand", "submit", {**stand_contract("by-hand")}))
    stand.save(stand.text + NEW)
    stand.settle()

    assert "another session is called by-hand" in stand.rejected


def stand_contract(id):
    from .conftest import make_submit

    return make_submit(id).body


def test_an_edit_of_an_old_rendering_is_merged_into_the_present(stand, submit):
    text = stand.text
    for number in range(30):
        stand.commit("agent", submit(f"s{number}"))
        stand.settle(1)
    stand.save(text.replace("priority: 0", "priority: 5", 1))
    stand.settle()

    assert stand.sessions["a"].contract.priority == 5
    assert stand.rejected == ""


def test_a_rendering_that_nobody_made_is_refused_as_a_whole(stand):
    for view in ("view: 999999", "views: 1"):
        stand.save(re.sub("view: \\d+", view, stand.text, count=1).replace("priority: 0", "priority: 5", 1))
        stand.settle()

    assert "the journal does not show what was rendered at record 999999; it stands at 2" in stand.rejected
    assert "its first lines do not name the rendering that it was made from" in stand.rejected
    assert stand.rejected.count("priority: 5") == 2
    assert events(stand) == []


def test_windows_line_ends_and_a_byte_order_mark_are_no_edit(stand):
    stand.file.write_bytes(b"\xef\xbb\xbf" + stand.text.replace("\n", "\r\n").encode())
    stand.settle()

    assert stand.rejected == ""


def test_the_note_of_a_refusal_goes_after_a_while(stand):
    stand.edit("state: pending", "state: succeeded")
    stand.settle()
    assert "> **Refused:**" in stand.text
    stand.save(stand.text)
    stand.settle()
    assert stand.rejected.count("**Refused:**") == 1

    stand.clock.advance(601)
    stand.save(stand.text)
    stand.settle()
    assert "> **Refused:**" not in stand.text
