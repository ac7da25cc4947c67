"""Every problem of a document is told at its place, whoever wrote it."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.operations.lint import lint_file
from phyagentos.protocol.documents.document import iter_blocks
from phyagentos.protocol.sessions.lessons import Lesson, render_lessons
from phyagentos.protocol.sessions.memory_entries import EntryState, Scope
from phyagentos.store.document_registry import FORMATS, check_document
from tools.write_reference import render_pristine

LESSONS = """\
---
phy: lessons/1
---

# Lessons

## slow_carry

```yaml
id: slow_carry
statement: Red cubes slip.
confidence: 1.5
suported: 3
scope:
  skil: pick
  entities: red_cube
```

## no_statement

```yaml
id: no_statment
state: actve
```
"""


def problems_of(text: str, file: str) -> list[str]:
    with pytest.raises(DefinitionError) as caught:
        check_document(text, file, "F.md")
    return [str(problem) for problem in caught.value.problems]


def test_every_problem_of_every_block_is_told_at_its_place():
    message = problems_of(LESSONS, "LESSONS.md")

    assert [line.partition(";")[0] for line in message] == [
        "F.md:12:1: INVALID_VALUE: found 1.5",
        "F.md:13:1: UNKNOWN_NAME (key): found 'suported'",
        "F.md:15:3: UNKNOWN_NAME (key): found 'skil'",
        "F.md:16:3: INVALID_VALUE: found 'red_cube'",
        "F.md:23:1: INVALID_VALUE: found 'actve'",
        "F.md:22:1: MISSING_VALUE: found nothing",
    ]
    assert "expected a number <= 1.0" in message[0]
    assert "Did you mean 'supported'?" in message[1]
    assert "expected active, expired, hypothesis, retracted. Did you mean 'active'?" in message[4]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("phy: lessons/1", "phy: lesson/1"), "F.md:2:1: INVALID_VALUE: found 'lesson/1'; expected 'lessons/1'"),
        (("---\nphy: lessons/1\n---\n", ""), "F.md:1:1: MISSING_VALUE"),
        (("phy:", "colour: red\nphy:"), "F.md:2:1: UNKNOWN_NAME (key): found 'colour'; expected phy"),
        (("id: grip", "id: grap"), "INVALID_VALUE: found 'grap'; expected its heading 'grip'"),
        (("id: grip", "id: grip\nid: grip"), "DUPLICATE_NAME: found 'id'"),
        (("id: grip", "id: [grip"), "SYNTAX"),
        (("\n```\n", "\n"), "F.md:21:1: SYNTAX: expected a line '```' below"),
        (("## grip", "## grip\n\n```yaml\nid: grip\nstatement: x\n```\n\n## grip"), "DUPLICATE_NAME: found 'grip'"),
    ],
)
def test_what_is_wrong_with_a_document_is_named(change, problem):
    text = render_lessons([Lesson(id="grip", statement="Wide grips hold.")])
    assert change[0] in text
    message = problems_of(text.replace(*change, 1), "LESSONS.md")
    assert (len(message), problem in message[0]) == (1, True)


def test_a_block_that_has_no_place_in_a_document_is_named():
    text = render_pristine()
    block = "\n## Snapshto\n\n```yaml\ntime_s: 0.0\n```\n"
    assert "UNKNOWN_NAME (block): found 'Snapshto'; expected Snapshot. Did you mean 'Snapshot'?" in str(
        problems_of(text["ENVIRONMENT.md"] + block, "ENVIRONMENT.md")
    )
    assert "UNKNOWN_NAME (block): found 'Snapshto'; expected no block of YAML" in str(
        problems_of(text["LOG.md"].replace("Nothing", "## Snapshto\n\n```yaml\nx: 1\n```\n\nNothing"), "LOG.md")
    )


def test_a_line_of_the_log_that_is_none_is_named():
    text = render_pristine()["LOG.md"] + "\n## 2026-11-21\n\n- 12:00:00 **g** (agent) fine\n- yesterday\n"
    (message,) = problems_of(text, "LOG.md")
    assert "INVALID_VALUE: found '- yesterday'; expected '- hh:mm:ss **about** (by) text'" in message


def test_what_is_fenced_is_neither_heading_nor_block():
    text = "## a\n\n````markdown\n## b\n\n```yaml\nx: 1\n```\n````\n\n```mermaid\n## c\n```\n\n```yaml\ny: 2\n```\n"
    assert [(block.name, block.yaml, block.line) for block in iter_blocks(text)] == [("a", "y: 2\n", 16)]


DRAFT = """
## mine

```yaml
contract:
  objective: Home, please
  skill: home
  target: panda
  accept: ["visible(red_cube)"]
  scene: {name: tabletop/cubes_and_trays}
```
"""


def test_a_session_that_a_person_adds_is_checked_as_the_one_who_takes_it_in_does():
    text = render_pristine()["SESSIONS.md"] + DRAFT
    check_document(text, "SESSIONS.md")

    line = text.split("  skill: home")[0].count("\n") + 1
    (message,) = problems_of(text.replace("  skill: home", "  skil: home\n  skill: home"), "SESSIONS.md")
    assert message.startswith(f"F.md:{line}:3: UNKNOWN_NAME (key): found 'skil'")
    assert "NOT_PERMITTED: found 'goal'" in str(
        problems_of(text.replace("  skill:", "  goal: g\n  skill:"), "SESSIONS.md")
    )
    assert "MISSING_VALUE: found nothing; expected key 'contract'" in str(
        problems_of(text.replace("contract:", "state: pending\ncontrac:"), "SESSIONS.md")
    )


def test_a_request_that_a_person_adds_is_checked_as_a_signal():
    text = render_pristine()["RUNTIME_SIGNAL.md"] + "\n## Request\n\n```yaml\nkind: cancel\nby: ann\n```\n"
    check_document(text, "RUNTIME_SIGNAL.md")

    message = problems_of(text.replace("kind: cancel", "kind: cancle\nsesion: a"), "RUNTIME_SIGNAL.md")
    assert [line.partition("; ")[0].partition(": ")[2] for line in message] == [
        "INVALID_VALUE: found 'cancle'",
        "UNKNOWN_NAME (key): found 'sesion'",
    ]


def test_a_retracted_lesson_stays_in_the_document():
    lesson = Lesson(id="grip", statement="s", scope=Scope(skill="pick"), state=EntryState.RETRACTED, reason="by eye")
    text = render_lessons([lesson])
    assert "state: retracted\nreason: by eye\n" in text
    check_document(text, "LESSONS.md")


@pytest.mark.parametrize("file", FORMATS)
def test_a_pristine_document_is_empty_valid_and_says_who_writes_it(root, file):
    text = (root / "protocol" / file).read_text(encoding="utf-8")
    check_document(text, file)
    assert list(iter_blocks(text)) == []
    assert text == render_pristine()[file], "run `make schemas`"
    for said in ("**Written by**", "dit") if file != "SESSIONS.md" else ("**This file can be edited**",):
        assert said in text


@pytest.mark.parametrize("file", FORMATS)
def test_lint_accepts_every_pristine_document_and_refuses_a_damaged_one(root, tmp_path, file):
    path = tmp_path / file
    path.write_text((root / "protocol" / file).read_text(encoding="utf-8"), encoding="utf-8")
    assert lint_file(path) == []
    path.write_text(path.read_text(encoding="utf-8").replace("phy: ", "phi: ", 1), encoding="utf-8")
    message = [str(problem) for problem in lint_file(path)]
    assert message[0].startswith(f"{path}:2:1: UNKNOWN_NAME (key): found 'phi'")
    assert f"{path}:2:1: MISSING_VALUE: found nothing; expected key 'phy'. Add 'phy'." in message
