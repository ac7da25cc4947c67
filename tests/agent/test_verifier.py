"""Verdicts, causes and revisions from synthetic evidence."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from phyagentos.agent.judging.causes import Cause, Layer
from phyagentos.agent.judging.diagnosis import diagnose
from phyagentos.agent.judging.judges.metrics import HoldJudge, MetricJudge
from phyagentos.agent.judging.judges.predicates import PredicateJudge
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.agent.repair.case import UnmetObjective
from phyagentos.agent.repair.retrying import revise
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Ended, Execution, Session
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.protocol.sessions.trace import Role, TraceEvent, find_label
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.world.idealisations import Aspect, Idealisation
from phyagentos.protocol.world.truth import Truth
from phyagentos.testing import make_contract

from .conftest import make_world, put, remove

BUDGET = History(replans=0, max_replans=2)
AWAY = (0.5, 0.1, 0.02)
IN_TRAY = (0.6, 0.3, 0.03)


def make_session(**more: Any) -> Session:
    facts = {
        "id": "g.red",
        "node": "red",
        "parameters": {"destination": "red_tray", "object": "red_cube"},
        "accept": ("inside(red_cube, red_tray)",),
    }
    return make_contract(**(facts | more))


def make_bundle(after: Any = None, *, session: Session | None = None, **more: Any) -> Bundle:
    execution = {"ended": Ended.COMPLETED, "evidence": "e", "ticks": 100} | more.pop("execution", {})
    facts: dict[str, Any] = {
        "folder": Path("e"),
        "session": session or make_session(),
        "execution": Execution(**execution),
        "before": make_world(),
        "after": after,
        "holds": (),
        "trace": (),
        "events": (),
    }
    return Bundle(**(facts | more))


def failed(code: str, leaf: str = "pick/verify") -> dict[str, Any]:
    return {"ended": Ended.SKILL_FAILED, "code": code, "leaf": leaf}


def test_success_needs_every_criterion_to_be_true():
    session = make_session(accept=("inside(red_cube, red_tray)", "not moved(blue_cube)"))
    bundle = make_bundle(put(make_world(), "red_cube", IN_TRAY), session=session)
    attempt = SessionVerifier().judge(bundle, BUDGET)
    assert attempt.verdict is Verdict.SUCCESS
    assert [(c.text, c.truth, c.evidence) for c in attempt.criteria] == [
        ("inside(red_cube, red_tray)", Truth.TRUE, "environment_after.json"),
        ("not moved(blue_cube)", Truth.TRUE, "environment_after.json"),
    ]
    assert (attempt.cause, attempt.sensing) == ("", "truth")


def perceive(world, *hidden):
    """The world as cameras know it, without what is hidden."""
    objects = {
        name: msgspec.structs.replace(entity, visible=name not in hidden) for name, entity in world.entities.items()
    }
    return msgspec.structs.replace(world, sensing="perceived", entities=objects)


DONE, MISSED = put(make_world(), "red_cube", IN_TRAY), put(make_world(), "red_cube", AWAY)
SPENT = History(replans=2, max_replans=2)
BOTH = {"accept": ("inside(red_cube, red_tray)", "upright(bottle)")}
PICK = {"skill": "pick", "accept": ("holding(panda, red_cube)",), "parameters": {"object": "red_cube"}}
UNSEEN = {"cause": Cause.EVIDENCE_MISSING, "missing_evidence": ("red_cube",)}


@pytest.mark.parametrize(
    ("after", "contract", "history", "expected", "said"),
    [
        pytest.param(
            DONE,
            {"accept": ()},
            BUDGET,
            {"verdict": Verdict.FAILURE},
            "the contract has no criterion, so nothing can be accepted",
            id="without criteria nothing is a success",
        ),
        pytest.param(
            DONE,
            {"accept": ("inside(red_cube, red_tray)", "open(drawer)")},
            BUDGET,
            {"verdict": Verdict.REPLAN, "cause": Cause.EVIDENCE_MISSING},
            "open(drawer) is unknown: drawer is not in the snapshot",
            id="unknown is never a success",
        ),
        pytest.param(
            DONE,
            {"hold": ("upright(bottle)",)},
            BUDGET,
            {"verdict": Verdict.REPLAN, "cause": Cause.EVIDENCE_MISSING, "missing_evidence": ()},
            "upright(bottle) is unknown: it was never sampled",
            id="what had to hold all through is unknown without a sample and cannot be seen afterwards",
        ),
        pytest.param(
            make_world(),
            PICK,
            BUDGET,
            {"verdict": Verdict.REPLAN, "cause": Cause.GRASP_MISSED},
            "panda holds nothing, its fingers 80 mm apart",
            id="fingers that closed on air are a missed grasp although the skill completed",
        ),
        pytest.param(
            make_world(),
            {},
            SPENT,
            {"verdict": Verdict.FAILURE},
            "The budget of 2 replans is spent.",
            id="a spent budget turns a replan into a failure",
        ),
        pytest.param(
            perceive(DONE, "red_cube"),
            BOTH,
            BUDGET,
            UNSEEN | {"verdict": Verdict.REPLAN},
            "First look again at red_cube. Replan 1 of 2.",
            id="unknown asks to look at what was not seen",
        ),
        pytest.param(
            perceive(DONE, "red_cube"),
            {},
            SPENT,
            UNSEEN | {"verdict": Verdict.FAILURE},
            "",
            id="what should be looked at is named even when the budget is spent",
        ),
        pytest.param(
            remove(perceive(DONE), "red_cube"),
            {},
            BUDGET,
            UNSEEN,
            "",
            id="what is missing in a perceived world is looked for before it is called gone",
        ),
        pytest.param(
            perceive(MISSED, "bottle"),
            BOTH,
            BUDGET,
            {"cause": Cause.PLACED_WRONG, "missing_evidence": ()},
            "",
            id="something false is not looked at again",
        ),
    ],
)
def test_only_what_evidence_shows_is_accepted_and_what_is_missing_is_named(after, contract, history, expected, said):
    attempt = SessionVerifier().judge(make_bundle(after, session=make_session(**contract)), history)
    assert {name: getattr(attempt, name) for name in expected} == expected
    assert said in attempt.reason


@pytest.mark.parametrize(
    ("judges", "unanswered"),
    [
        ((HoldJudge(), MetricJudge()), "inside(red_cube, red_tray)"),
        ((PredicateJudge(), HoldJudge()), "metric(ticks) <= 1000"),
        ((PredicateJudge(), MetricJudge()), "upright(bottle)"),
    ],
)
def test_what_none_of_the_judges_answers_is_unknown_and_never_met(judges, unanswered):
    session = make_session(accept=("inside(red_cube, red_tray)", "metric(ticks) <= 1000"), hold=("upright(bottle)",))
    upright = Criterion(text="upright(bottle)", kind="hold", truth=Truth.TRUE)
    bundle = make_bundle(put(make_world(), "red_cube", IN_TRAY), session=session, holds=(upright,))
    attempt = SessionVerifier(judges=judges).judge(bundle, BUDGET)
    assert attempt.verdict is not Verdict.SUCCESS
    assert [each.text for each in attempt.criteria if each.truth is Truth.UNKNOWN] == [unanswered]
    assert f"{unanswered} is unknown: no judge of this session answers it" in attempt.reason


@pytest.mark.parametrize(
    ("after", "execution", "cause", "layer", "verdict"),
    [
        (put(make_world(), "red_cube", AWAY), failed("GRASP_LOST"), Cause.GRASP_LOST, Layer.EXECUTION, Verdict.REPLAN),
        (make_world(), failed("GRASP_MISSED"), Cause.GRASP_MISSED, Layer.EXECUTION, Verdict.REPLAN),
        (put(make_world(), "red_cube", AWAY), failed("GRASP_MISSED"), Cause.OBJECT_MOVED, Layer.WORLD, Verdict.REPLAN),
        (remove(make_world(), "red_cube"), failed("GRASP_MISSED"), Cause.OBJECT_GONE, Layer.WORLD, Verdict.FAILURE),
        (make_world(), failed("NO_PLAN"), Cause.NO_PLAN, Layer.PLANNING, Verdict.REPLAN),
        (make_world(), failed("NO_PATH_FOUND"), Cause.NO_PLAN, Layer.PLANNING, Verdict.REPLAN),  # of an earlier release
        (make_world(), failed("NOT_GRASPABLE"), Cause.IMPOSSIBLE, Layer.PLANNING, Verdict.REPLAN),
        (make_world(), failed("SOMETHING_OF_A_PLUGIN"), Cause.UNKNOWN, Layer.EXECUTION, Verdict.REPLAN),
        (make_world(), {"ended": Ended.STALLED, "leaf": "pick/move"}, Cause.STALLED, Layer.EXECUTION, Verdict.REPLAN),
        (make_world(), {"ended": Ended.TIMED_OUT}, Cause.TIMED_OUT, Layer.RUNTIME, Verdict.REPLAN),
        (make_world(), {"ended": Ended.RUNNER_LOST}, Cause.RUNNER_LOST, Layer.RUNTIME, Verdict.REPLAN),
        (make_world(), {"ended": Ended.SAFETY_STOP, "code": "GUARD"}, Cause.SAFETY_STOP, Layer.SAFETY, Verdict.REPLAN),
        (make_world(), {"ticks": 0}, Cause.NOTHING_CHANGED, Layer.ACCEPTANCE, Verdict.FAILURE),
        (make_world(), {"ticks": 0, "code": "ALREADY_MET"}, Cause.WITHOUT_EFFECT, Layer.ACCEPTANCE, Verdict.REPLAN),
        (make_world(), {}, Cause.WITHOUT_EFFECT, Layer.ACCEPTANCE, Verdict.REPLAN),
        (put(make_world(), "red_cube", AWAY), {}, Cause.PLACED_WRONG, Layer.ACCEPTANCE, Verdict.REPLAN),
        (None, {"ended": Ended.RUNNER_LOST}, Cause.EVIDENCE_MISSING, Layer.EVIDENCE, Verdict.FAILURE),
    ],
)
def test_the_cause_comes_from_evidence_and_decides_whether_another_attempt_is_worth_it(
    after, execution, cause, layer, verdict
):
    bundle = make_bundle(after, execution=execution)
    attempt = SessionVerifier().judge(bundle, BUDGET)
    assert (attempt.cause, attempt.verdict) == (cause.value, verdict)
    assert diagnose(bundle, attempt.criteria).cause.layer is layer


@pytest.mark.parametrize("verdict", [Verdict.FAILURE, Verdict.REPLAN])
def test_a_miss_without_a_cause_cannot_be_made(verdict):
    assert Attempt(verdict=verdict, criteria=()).cause == "UNKNOWN"
    recorded = msgspec.json.encode({"verdict": verdict, "criteria": []})
    assert msgspec.json.decode(recorded, type=Attempt).cause == "UNKNOWN"


@pytest.mark.parametrize("verdict", [Verdict.SUCCESS, Verdict.UNVERIFIED])
def test_what_missed_nothing_is_no_miss(verdict):
    assert UnmetObjective.of_execution(make_bundle(make_world()), Attempt(verdict=verdict, criteria=())) is None


def test_the_reason_names_the_leaf_and_the_number_that_decided():
    trace = (
        TraceEvent(
            tick=5,
            time_s=1.0,
            path="pick/verify",
            leaf="verify_grasp",
            status="FAILURE",
            code="GRASP_MISSED",
            message="the fingers touch red_cube from neither side",
            numbers={"width_m": 0.0004},
        ),
    )
    attempt = SessionVerifier().judge(make_bundle(make_world(), execution=failed("GRASP_MISSED"), trace=trace), BUDGET)
    assert "from neither side, in pick/verify (width_m 0.0004)" in attempt.reason


def _violated() -> Criterion:
    return Criterion(text="upright(bottle)", kind="hold", truth=Truth.FALSE, at_s=2.5, because="it leans 40 degrees")


def test_a_violated_constraint_is_replanned_slower_when_the_world_has_recovered():
    session = make_session(hold=("upright(bottle)",))
    after = put(make_world(), "red_cube", IN_TRAY)
    bundle = make_bundle(after, session=session, holds=(_violated(),), execution={"ended": Ended.SAFETY_STOP})
    attempt = SessionVerifier().judge(bundle, BUDGET)
    assert (attempt.verdict, attempt.cause) == (Verdict.REPLAN, Cause.CONSTRAINT_VIOLATED)
    assert "upright(bottle) was false at 2.50 s: it leans 40 degrees" in attempt.reason
    assert revise(UnmetObjective.of_execution(bundle, attempt)).strategy == Strategy(speed=0.5)


def test_judges_of_others_are_weighed_like_the_own_ones():
    class Sceptic:
        name = "sceptic/1"

        def judge(self, bundle: Bundle) -> list[Criterion]:
            return [Criterion(text="upright(bottle)", kind="accept", truth=Truth.FALSE, because="the picture shows it")]

    verifier = SessionVerifier(judges=(PredicateJudge(), Sceptic()), name="sceptic/1")
    attempt = verifier.judge(make_bundle(put(make_world(), "red_cube", IN_TRAY)), BUDGET)
    assert attempt.verdict is not Verdict.SUCCESS
    assert (attempt.verifier, attempt.judges) == ("sceptic/1", ("predicates/2", "sceptic/1"))


def _planned(leaf: str, *labels: str) -> TraceEvent:
    return TraceEvent(
        tick=1, time_s=0.0, path=f"a/{leaf}", leaf=leaf, status="SUCCESS", numbers={"labels": list(labels)}
    )


def _moved(label: str) -> TraceEvent:
    return TraceEvent(tick=2, time_s=1.0, path="a/move_to", leaf="move_to", status="SUCCESS", numbers={"label": label})


TRACE = (
    _planned("plan_grasp", "yaw+000", "yaw+090"),
    _moved("yaw+090"),
    _planned("plan_place", "site2.yaw+000", "site1.yaw+000"),
    _moved("site1.yaw+000"),
)


def _revise(cause: Cause, *, of_skill: tuple[str, ...] = (), **more: Any) -> Any:
    session = make_session(**more)
    bundle = make_bundle(put(make_world(), "red_cube", AWAY), session=session, trace=TRACE)
    attempt = Attempt(verdict=Verdict.REPLAN, criteria=(), cause=cause.value)
    return revise(UnmetObjective.of_execution(bundle, attempt), of_skill)


def test_the_approach_that_was_carried_out_is_told_from_those_that_were_found():
    bundle = make_bundle(make_world(), trace=TRACE)
    assert find_label(bundle.trace, Role.PLAN_GRASP) == "yaw+090"
    assert find_label(bundle.trace, Role.PLAN_SITE) == "site1.yaw+000"
    assert find_label((), Role.PLAN_GRASP) == ""


@pytest.mark.parametrize(
    ("cause", "before", "after"),
    [
        (Cause.GRASP_MISSED, DEFAULT_STRATEGY, Strategy(avoid_grasps=("yaw+090",))),
        (Cause.GRASP_LOST, DEFAULT_STRATEGY, Strategy(avoid_grasps=("yaw+090",), speed=0.5)),
        (
            Cause.GRASP_LOST,
            Strategy(speed=0.3, avoid_grasps=("yaw+000",)),
            Strategy(avoid_grasps=("yaw+000", "yaw+090"), speed=0.25),
        ),
        (Cause.PLACED_WRONG, DEFAULT_STRATEGY, Strategy(avoid_sites=("site1",), speed=0.5)),
        (Cause.OBJECT_MOVED, DEFAULT_STRATEGY, DEFAULT_STRATEGY),
        (Cause.ADAPTER_REFUSED, DEFAULT_STRATEGY, Strategy(avoid_sites=("site1.yaw+000",))),
        (Cause.NO_PLAN, Strategy(avoid_grasps=("yaw+000",), speed=0.5), Strategy(speed=0.5)),
        (Cause.TIMED_OUT, DEFAULT_STRATEGY, DEFAULT_STRATEGY),
    ],
)
def test_the_strategy_answers_the_cause(cause, before, after):
    revision = _revise(cause, strategy=before)
    assert revision.strategy == after
    assert revision.parent == "g.red"


def test_a_way_that_was_refused_before_any_site_was_chosen_is_another_grasp():
    bundle = make_bundle(make_world(), session=make_session(), trace=TRACE[:2])
    attempt = Attempt(verdict=Verdict.REPLAN, criteria=(), cause=Cause.ADAPTER_REFUSED.value)
    assert revise(UnmetObjective.of_execution(bundle, attempt)).strategy == Strategy(avoid_grasps=("yaw+090",))


def test_the_child_requires_to_see_the_object_and_not_that_it_stands_where_its_skill_wanted_it():
    stood = "at(red_cube, (0.4, 0.3, 0.02), 0.03)"
    revision = _revise(Cause.OBJECT_MOVED, requires=(stood, "upright(bottle)"), of_skill=(stood, "upright(bottle)"))
    assert revision.requires == ("upright(bottle)", "visible(red_cube)")
    assert any("no longer required" in reason for reason in revision.reasons)


def test_the_child_requires_what_the_node_itself_does_whatever_the_world_is_now():
    stood = "at(red_cube, (0.4, 0.3, 0.02), 0.03)"
    assert _revise(Cause.OBJECT_MOVED, requires=(stood,)).requires == (stood, "visible(red_cube)")


def test_alike_objects_end_a_session_at_once_with_their_names():
    world = put(make_world(), "red_cube", IN_TRAY)
    pair = {"red_cube": "blue_cube", "blue_cube": "red_cube"}
    doubtful = {n: msgspec.structs.replace(world.entities[n], alternatives=(other,)) for n, other in pair.items()}
    after = msgspec.structs.replace(world, sensing="perceived", entities=world.entities | doubtful)
    attempt = SessionVerifier().judge(make_bundle(after), BUDGET)

    assert (attempt.verdict, attempt.cause, attempt.missing_evidence) == (Verdict.FAILURE, Cause.AMBIGUOUS, ())
    assert attempt.criteria[0].alternatives == ("blue_cube", "red_cube")
    assert "blue_cube and red_cube look alike" in attempt.reason

    agreed = make_session(interchangeable=(("red_cube", "blue_cube"),))
    attempt = SessionVerifier().judge(make_bundle(after, session=agreed), BUDGET)
    assert attempt.verdict is Verdict.SUCCESS
    assert "by agreement" in attempt.criteria[0].because


def test_a_verdict_names_what_was_idealised_in_its_evidence():
    idealised = (Idealisation(Aspect.FRICTION, "coin"),)
    bundle = make_bundle(put(make_world(), "red_cube", IN_TRAY), execution={"idealisations": idealised})

    assert SessionVerifier().judge(bundle, BUDGET).idealisations == idealised
