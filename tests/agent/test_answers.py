"""Criteria that a person judges: the verdict waits where a person can answer, and is unknown where none answers."""

import pytest

from phyagentos.agent.mission.patience import Patience
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.predicates.predicate import find_question, has_metric, parse_predicate
from phyagentos.protocol.sessions.answers import Answer, keep_answer
from phyagentos.protocol.world.truth import Truth

FLAT, CLEAN = "Does the red_cube lie flat?", "Is the table clean?"
GRAPH = """
    goal: tidy
    objective: The red cube into its tray.
    scene: table
    targets: {arm: panda}
    defaults: {max_replans: 1, answer_s: %s}
    sessions:
      red:
        skill: pick_and_place
        target: arm
        with: {object: red_cube, destination: red_tray}
        accept: [{human: "Does the ${object} lie flat?"}]
    accept: ["inside(red_cube, red_tray)", {human: Is the table clean?}]
    """


class Person:
    """Answers the open question, one look at the records later."""

    def __init__(self, stage, **says):
        self.workspace, self.says, self.looks = stage.workspace, says, 0

    def on_change(self, goal, ledger):
        for status in ledger.sessions.values():
            if status.state == "awaiting_verification":
                self.answer(self.workspace.evidence_of(status.contract.id), FLAT, self.says["flat"])
        self.answer(self.workspace.answers_of(goal.id), CLEAN, self.says["clean"])

    def answer(self, folder, question, truth):
        keep_answer(folder, Answer(question=question, truth=truth, by="ann", at="2026-11-29T08:00:00Z"))


def pursue(stage, graph, *people, patience=True):
    patient = Patience(SystemClock()) if patience else None
    mission = stage.make_mission(observers=[stage.runtime, *people])
    mission.patience = patient
    return mission.run(graph, seed=7), mission.ledger


@pytest.mark.parametrize("patience", [False, True])
def test_without_an_answer_in_time_the_criterion_is_unknown_and_nothing_is_repeated(make_stage, write_graph, patience):
    report, ledger = pursue(make_stage(), write_graph(GRAPH % "0.05"), patience=patience)
    (status,) = ledger.sessions.values()
    (judged,) = (each for each in status.decision.criteria if find_question(each.text))
    assert (judged.text, judged.truth, judged.because) == (
        f"human: {FLAT}",
        Truth.UNKNOWN,
        "no person has answered",
    )
    assert (report.verdict, status.state, status.decision.cause) == ("failure", "failed", "EVIDENCE_MISSING")


def test_yes_in_time_is_evidence_with_a_name_and_decides(make_stage, write_graph):
    stage = make_stage()
    report, ledger = pursue(stage, write_graph(GRAPH % 60), Person(stage, flat=Truth.TRUE, clean=Truth.TRUE))
    (status,) = ledger.sessions.values()
    (judged,) = (each for each in status.decision.criteria if find_question(each.text))
    assert (report.verdict, judged.truth, judged.because[:21]) == ("success", Truth.TRUE, "yes, answered by ann ")
    assert judged.evidence in {each.file for each in status.decision.evidence}


@pytest.mark.parametrize(
    ("says", "states", "reason"),
    [
        ({"flat": Truth.FALSE, "clean": Truth.TRUE}, ["replanned", "failed"], "node red cannot be done"),
        ({"flat": Truth.TRUE, "clean": Truth.FALSE}, ["succeeded"], f"human: {CLEAN} is false: no, answered by ann"),
    ],
)
def test_no_is_false_and_the_objective_of_a_session_is_tried_again(make_stage, write_graph, says, states, reason):
    stage = make_stage()
    report, ledger = pursue(stage, write_graph(GRAPH % 60), Person(stage, **says))
    assert (report.verdict, report.reason.startswith(reason)) == ("failure", True)
    assert [each.state for each in ledger.sessions.values()] == states


def test_a_question_is_a_criterion_of_its_own_which_no_snapshot_decides():
    parsed = parse_predicate("human:  Is it   clean?")
    expected = ("human: Is it clean?", False, False, parsed)
    assert (
        parsed.text,
        parsed.is_lasting,
        has_metric(parsed.text),
        parse_predicate(parsed.text),
    ) == expected
    for text in ("human:", "human: Is ${thing} clean?"):
        with pytest.raises(DefinitionError):
            parse_predicate(text)
