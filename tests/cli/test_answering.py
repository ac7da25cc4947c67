"""`paos answer` and `paos contest`: what people say stands beside the verdict, with who and when, and never over it."""

import json
import re

import msgspec
import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.export.demonstrations import Choice, _find_reason
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, write_json
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.world.truth import Truth
from phyagentos.testing import make_contract
from phyagentos.view.actions import perform
from phyagentos.view.documents import Documents
from phyagentos.view.pages import PanelRenderer
from phyagentos.view.panels import PANELS, Query
from tests.command_line import assert_ended, assert_refused

from .test_verify import AWAY, IN_TRAY, SESSION, make_world

QUESTION = "Is the table clean?"


@pytest.fixture
def unanswered(run):
    """A session that was judged without an answer."""
    run.begin()
    accept = ("inside(red_cube, red_tray)", f"human: {QUESTION}")
    session = make_contract(id=SESSION, goal="tidy-7", node="red", accept=accept)
    run.write(Side.AGENT, SESSION, "submit", **msgspec.to_builtins(session))
    run.execute(SESSION, Ended.COMPLETED)
    folder = run.workspace.evidence_of(SESSION)
    folder.mkdir()
    write_json(folder / BEFORE, make_world(AWAY, 0.0))
    write_json(folder / AFTER, make_world(IN_TRAY, 9.0))
    run.judge(SESSION, Verdict.FAILURE, Truth.UNKNOWN)
    return run


@pytest.fixture
def type_(paos, unanswered):
    return lambda *words: paos(*words, "-w", unanswered.workspace.root)


def fold(run):
    return read_ledger(run.workspace.root).sessions[SESSION]


def test_an_open_question_stands_in_status_and_why_until_it_is_answered(type_):
    assert (type_("status").out + type_("why").out).count(f"{QUESTION} `paos answer {SESSION} yes|no") == 2
    type_("answer", "red", "yes")
    assert json.loads(type_("status", "--json").out)["questions"] == []
    assert_refused(type_("answer", "red", "no"), "no question that waits")


def test_an_answer_is_kept_with_its_name_judged_on_beside_the_verdict_and_not_changed_unseen(type_, unanswered):
    assert_ended(
        type_("answer", "red", "yes", "--by", "ann"),
        ExitCode.GOAL_MET,
        out=[f"{SESSION}: {QUESTION} yes, answered by ann at "],
    )
    status = fold(unanswered)
    assert (status.state, [each.verdict for each in status.attempts]) == ("failed", ["failure", "success"])
    (file,) = unanswered.workspace.evidence_of(SESSION).glob("answers/*")
    assert '"truth":"true","by":"ann"' in file.read_text()
    file.write_text(file.read_text().replace("true", "false"))
    assert str(file) in type_("evidence", "verify").err


@pytest.mark.parametrize(
    ("words", "texts"),
    [
        (("red", "perhaps"), ("found 'perhaps'; expected yes or no",)),
        (("red", "yes", "--question", "3"), (f"1 {QUESTION}",)),
        (("tidy-7", "yes"), ("no question that waits", SESSION)),
        (("blue", "yes"), ("no such session",)),
    ],
)
def test_an_answer_to_nothing_is_refused(type_, words, texts):
    assert_refused(type_("answer", *words), *texts)


def test_a_contested_verdict_stays_and_says_who_contests_it_and_why(type_, unanswered):
    done = type_("contest", "red", "--because", "It leans.", "--by", "bob")
    assert (done.code, "the verdict stays failure" in done.out) == (ExitCode.GOAL_MET, True), done.err
    assert fold(unanswered).decision.verdict == "failure"
    assert re.search("  contested   success, by bob at 2.*: It leans.", type_("why", "red").out)


def test_a_contested_success_is_no_demonstration_unless_it_is_wanted(paos, replanned):
    paos("contest", "red.r1", "--because", "It leans.", "-w", replanned.workspace.root)
    status = read_ledger(replanned.workspace.root).sessions["tidy-7.red.r1"]
    folder, wanted = replanned.workspace.evidence_of(status.contract.id), (Choice(), Choice(contested=True))
    reasons = [_find_reason(folder, status, each) for each in wanted]
    assert reasons == ["a person who contests it", "no trajectory: thinned, or gone"]


def test_the_page_shows_the_question_with_a_form_that_answers_it_and_one_that_contests(unanswered):
    documents = Documents(unanswered.workspace.root)
    documents.refresh()
    (panel,) = (each for each in PANELS if each.name == "questions")
    renderer = PanelRenderer(documents, lambda: {"actions": True, "live": True})
    shown = renderer.render(panel, Query())
    answered = perform(unanswered.workspace, "answer", {"subject": SESSION, "question": "1", "says": "no"})
    perform(unanswered.workspace, "contest", {"session": SESSION, "because": "It leans."})
    documents.refresh()

    assert QUESTION in shown
    assert 'name="says" value="yes"' in shown
    assert answered.command == f"paos answer {SESSION} no --question 1 -w {unanswered.workspace.root}"
    assert QUESTION not in renderer.render(panel, Query())
    verdicts = [each.verdict for each in fold(unanswered).attempts]
    assert verdicts == ["failure", "failure", "success"]
