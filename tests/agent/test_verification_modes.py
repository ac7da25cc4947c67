"""What a judgement is for, who decides, and what should be looked at again."""

import pytest

from phyagentos.agent.judging.judges.predicates import PredicateJudge
from phyagentos.agent.judging.verifier import SessionVerifier
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.world.truth import Truth

from .conftest import Play, change, check_report, succeed
from .test_verifier import BUDGET, DONE, MISSED, make_bundle, perceive

GRAPH = """
    goal: tidy
    objective: Tidy up.
    scene: table
    targets: {arm: panda}
    sessions:
      red: {skill: pick_and_place, target: arm, with: {object: red_cube, destination: red_tray}}
      blue: {after: [red], skill: pick_and_place, target: arm, with: {object: blue_cube, destination: blue_tray}}
    accept: ["inside(red_cube, red_tray)"]
    """


@pytest.mark.parametrize(
    ("mode", "after", "ended", "verdict", "found"),
    [
        ("off", DONE, Ended.COMPLETED, "unverified", None),
        ("off", MISSED, Ended.SKILL_FAILED, "unverified", None),
        ("audit", MISSED, Ended.COMPLETED, "success", "replan"),
        ("audit", DONE, Ended.SKILL_FAILED, "failure", "success"),
        ("enforce", MISSED, Ended.COMPLETED, "failure", "failure"),
        ("enforce", DONE, Ended.SKILL_FAILED, "success", "success"),
        ("recovery", MISSED, Ended.COMPLETED, "replan", "replan"),
        ("recovery", DONE, Ended.SKILL_FAILED, "success", "success"),
    ],
)
def test_the_mode_says_who_decides(mode, after, ended, verdict, found):
    verifier = SessionVerifier(mode=VerificationMode(mode))
    attempt = verifier.judge(make_bundle(after, execution={"ended": ended}), BUDGET)
    assert (attempt.verdict, attempt.found, attempt.mode) == (verdict, found, mode)
    assert (attempt.criteria == ()) == (mode == "off")


def test_an_audit_that_fails_what_the_evidence_shows_as_met_names_how_the_execution_ended():
    execution = {"ended": Ended.SKILL_FAILED, "code": "GRASP_LOST"}
    attempt = SessionVerifier(mode=VerificationMode.AUDIT).judge(make_bundle(DONE, execution=execution), BUDGET)
    assert (attempt.verdict, attempt.found, attempt.cause) == ("failure", "success", "GRASP_LOST")


def lie(world, session):
    return Play(world=world)


def fail(world, session):
    return Play(world=world, ended=Ended.SKILL_FAILED, code="GRASP_LOST")


UNJUDGED = [("red", "unverified"), ("blue", "unverified")]
RED, BLUE = [("red", "succeeded")], [("blue", "succeeded")]


@pytest.mark.parametrize(
    ("mode", "act", "expected", "said"),
    [
        ("off", lie, {"verdict": "unverified", "exit_code": 1, "sessions": UNJUDGED}, ""),
        ("audit", lie, {"verdict": "failure", "exit_code": 1, "sessions": RED + BLUE}, ""),
        ("enforce", lie, {"verdict": "failure", "exit_code": 1, "sessions": [("red", "failed")]}, ""),
        (
            "recovery",
            lie,
            {"verdict": "success", "exit_code": 0, "sessions": [("red", "replanned"), ("red.r1", "succeeded"), *BLUE]},
            "",
        ),
        pytest.param(
            "off",
            fail,
            {"verdict": "failure", "nodes": {"red": "blocked", "blue": "blocked"}, "sessions": UNJUDGED[:1]},
            "",
            id="without verification a failed execution still stops what waits for it",
        ),
        pytest.param(
            "off",
            succeed,
            {"verdict": "unverified", "sessions": UNJUDGED},
            "verification is off: every execution completed, none was judged",
            id="what succeeded is no success without a judgement",
        ),
    ],
)
def test_a_goal_under_each_mode_when_the_controller_lies_or_fails(make_stage, write_graph, mode, act, expected, said):
    mission = make_stage({"red": act}).make_mission(verifier=SessionVerifier(mode=VerificationMode(mode)))
    report = mission.run(write_graph(GRAPH), seed=7)
    check_report(report, {"": said}, **expected)
    assert mode != "off" or report.first_attempt_success == {"red": False, "blue": False}


@pytest.mark.parametrize(
    ("mode", "said"),
    [
        (VerificationMode.RECOVERY, "First look again at red_cube, red_tray. Replan 1 of 2."),
        (VerificationMode.ENFORCE, "`--verify recovery` looks again at red_cube, red_tray."),
    ],
)
def test_the_least_certain_body_is_looked_at_again_though_it_is_fixed(mode, said):
    world = change(change(perceive(DONE), "red_cube", position_std_m=0.001), "red_tray", position_std_m=0.2)
    attempt = SessionVerifier(mode=mode).judge(make_bundle(world), BUDGET)
    assert (attempt.cause, attempt.missing_evidence) == ("EVIDENCE_MISSING", ("red_cube", "red_tray"))
    assert attempt.reason.endswith(said)


class Counting:
    name = "counting/1"

    def __init__(self) -> None:
        self.asked = 0

    def judge(self, bundle):
        self.asked += 1
        return [Criterion(text="looks well", kind="vision", truth=Truth.UNKNOWN, because="too dark")]


@pytest.mark.parametrize(("after", "asked"), [(DONE, 1), (MISSED, 0)])
def test_a_costly_judge_is_asked_only_when_nothing_is_false_yet(after, asked):
    costly = Counting()
    attempt = SessionVerifier(judges=(PredicateJudge(),), costly=(costly,)).judge(make_bundle(after), BUDGET)
    assert costly.asked == asked
    assert attempt.verdict is not Verdict.SUCCESS
    assert attempt.judges == ("predicates/2", "counting/1")
