"""What a judgement is for, who decides, and what should be looked at again."""

import msgspec
import pytest

from phyagentos.agent.judging.judges.predicates import PredicateJudge
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.world.truth import Truth

from .conftest import Play, make_world, put, succeed
from .test_verifier import AWAY, BUDGET, IN_TRAY, make_bundle, make_session

DONE, MISSED = put(make_world(), "red_cube", IN_TRAY), put(make_world(), "red_cube", AWAY)
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


def perceive(world, **hidden):
    things = {
        name: msgspec.structs.replace(entity, visible=name not in hidden) for name, entity in world.entities.items()
    }
    return msgspec.structs.replace(world, sensing="perceived", entities=things)


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


@pytest.mark.parametrize(
    ("mode", "verdict", "states", "exit_code"),
    [
        ("off", "unverified", ["unverified", "unverified"], 1),
        ("audit", "failure", ["succeeded", "succeeded"], 1),
        ("enforce", "failure", ["failed"], 1),
        ("recovery", "success", ["replanned", "succeeded", "succeeded"], 0),
    ],
)
def test_a_goal_under_each_mode_when_the_controller_lies(make_stage, write_graph, mode, verdict, states, exit_code):
    def lie(world, session):
        return Play(world=world)

    stage = make_stage({"red": lie})
    mission = stage.make_mission(verifier=SessionVerifier(mode=VerificationMode(mode)))
    report = mission.run(write_graph(GRAPH), seed=7)
    assert report.verdict == verdict
    assert sorted(session.state for session in report.sessions) == sorted(states)
    assert report.exit_code == exit_code


def test_without_verification_a_failed_execution_still_stops_what_waits_for_it(make_stage, write_graph):
    stage = make_stage({"red": lambda world, session: Play(world=world, ended=Ended.SKILL_FAILED, code="GRASP_LOST")})
    mission = stage.make_mission(verifier=SessionVerifier(mode=VerificationMode.OFF))
    report = mission.run(write_graph(GRAPH), seed=7)
    assert (report.verdict, report.nodes) == ("failure", {"red": "blocked", "blue": "blocked"})
    assert [session.state for session in report.sessions] == ["unverified"]
    assert report.first_attempt_success == {"red": False, "blue": False}


def test_what_succeeded_is_no_success_when_nobody_judged(make_stage, write_graph):
    stage = make_stage({"red": succeed})
    mission = stage.make_mission(verifier=SessionVerifier(mode=VerificationMode.OFF))
    report = mission.run(write_graph(GRAPH), seed=7)
    assert report.first_attempt_success == {"red": False, "blue": False}
    assert report.reason == "verification is off: every execution completed, none was judged"


def test_unknown_asks_to_look_at_what_was_not_seen():
    session = make_session(accept=("inside(red_cube, red_tray)", "upright(bottle)"))
    attempt = SessionVerifier().judge(make_bundle(perceive(DONE, red_cube=1), session=session), BUDGET)
    assert (attempt.verdict, attempt.cause, attempt.missing_evidence) == (
        Verdict.REPLAN,
        "EVIDENCE_MISSING",
        ("red_cube",),
    )
    assert "First look again at red_cube. Replan 1 of 2." in attempt.reason


@pytest.mark.parametrize(
    ("mode", "said"),
    [
        (VerificationMode.RECOVERY, "First look again at red_cube, red_tray. Replan 1 of 2."),
        (VerificationMode.ENFORCE, "`--verify recovery` looks again at red_cube, red_tray."),
    ],
)
def test_the_least_certain_body_is_looked_at_again_though_it_is_fixed(mode, said):
    world, stds_m = perceive(DONE), {"red_cube": 0.001, "red_tray": 0.2}
    known = {name: msgspec.structs.replace(world.entities[name], position_std_m=std) for name, std in stds_m.items()}
    world = msgspec.structs.replace(world, entities={**world.entities, **known})
    attempt = SessionVerifier(mode=mode).judge(make_bundle(world), BUDGET)
    assert (attempt.cause, attempt.missing_evidence) == ("EVIDENCE_MISSING", ("red_cube", "red_tray"))
    assert attempt.reason.endswith(said)


def test_a_thing_that_is_missing_in_a_perceived_world_is_looked_for_before_it_is_called_gone():
    seen = perceive(DONE)
    seen = msgspec.structs.replace(seen, entities={n: e for n, e in seen.entities.items() if n != "red_cube"})
    attempt = SessionVerifier().judge(make_bundle(seen), BUDGET)
    assert (attempt.cause, attempt.missing_evidence) == ("EVIDENCE_MISSING", ("red_cube",))


def test_something_false_is_not_looked_at_again():
    session = make_session(accept=("inside(red_cube, red_tray)", "upright(bottle)"))
    attempt = SessionVerifier().judge(make_bundle(perceive(MISSED, bottle=1), session=session), BUDGET)
    assert (attempt.missing_evidence, attempt.cause) == ((), "PLACED_WRONG")


def test_what_had_to_hold_all_through_cannot_be_seen_afterwards():
    session = make_session(hold=("upright(bottle)",))
    attempt = SessionVerifier().judge(make_bundle(DONE, session=session), BUDGET)
    assert (attempt.cause, attempt.missing_evidence) == ("EVIDENCE_MISSING", ())


def test_what_should_be_looked_at_is_told_even_when_the_budget_is_spent():
    attempt = SessionVerifier().judge(make_bundle(perceive(DONE, red_cube=1)), History(replans=2, max_replans=2))
    assert (attempt.verdict, attempt.missing_evidence) == (Verdict.FAILURE, ("red_cube",))


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
