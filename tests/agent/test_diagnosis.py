"""Causes told from evidence: a hand, a slip, a bad grasp and a bad place leave different traces."""

from typing import Any

import msgspec
import pytest

from phyagentos.agent.judging.causes import Cause, CauseClass
from phyagentos.agent.judging.diagnosis import diagnose, diagnose_after_looking
from phyagentos.agent.judging.judges.predicates import evaluate_criterion
from phyagentos.agent.judging.manipulation_timeline import ManipulationTimeline, Stage
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.trace import Role, TraceEvent
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.world.environment import SensorHealth, Status
from phyagentos.protocol.world.truth import Truth

from .conftest import change, make_world, put, remove
from .test_verifier import make_bundle as make_evidence

STEPS = {
    Stage.BEFORE: (),
    Stage.CLOSED: ((Role.GRASP, {}),),
    Stage.GRASPED: ((Role.GRASP, {}), (Role.VERIFY, {})),
    Stage.LIFTED: ((Role.GRASP, {}), (Role.VERIFY, {}), (Role.VERIFY, {})),
    Stage.RELEASED: ((Role.GRASP, {}), (Role.CARRY, {}), (Role.RELEASE, {"position_m": [0.6, 0.3, 0.03]})),
}
EARLIER = {
    Role.GRASP: "close_gripper",
    Role.VERIFY: "verify_grasp",
    Role.CARRY: "attach",
    Role.RELEASE: "detach",
}


def make_event(tick: int, path: str, role: Role | None, leaf: str = "a leaf of any name", **more: Any) -> TraceEvent:
    facts = {"status": "SUCCESS"} | more
    return TraceEvent(tick=tick, time_s=0.1 * tick, path=path, leaf=leaf, declared_role=role, **facts)


def make_bundle(after, stage: Stage = Stage.BEFORE, **execution: Any) -> Bundle:
    plan = make_event(0, "p/plan", Role.PLAN_GRASP)
    steps = (make_event(n, f"p/{n}", role, numbers=numbers) for n, (role, numbers) in enumerate(STEPS[stage]))
    acts = execution.get("leaf") == "policy"
    failure = (make_event(9, "policy", Role.ACT, status="FAILURE", code=execution["code"]),) if acts else ()
    return make_evidence(after, execution={"ended": Ended.SKILL_FAILED} | execution, trace=(plan, *steps, *failure))


@pytest.mark.parametrize("stage", STEPS)
def test_a_bundle_recorded_before_leaves_declared_their_roles_tells_the_same_stage(stage):
    bundle = make_bundle(make_world(), stage)
    earlier = [make_event(each.tick, each.path, None, EARLIER.get(each.role, "plan_grasp")) for each in bundle.trace]
    assert ManipulationTimeline.of(bundle, "red_cube").stage is stage
    assert ManipulationTimeline.of(msgspec.structs.replace(bundle, trace=tuple(earlier)), "red_cube").stage is stage


def test_what_was_done_to_an_object_in_the_way_is_not_done_to_the_object():
    """A can was moved out of the tray, and `red_cube was put down and then moved 0.6 m` was the cause."""
    made = (
        make_event(0, "p/room", Role.PLAN_ROOM, numbers={"things": ["can"]}),
        make_event(1, "p/locate", Role.SENSE, numbers={"object": "can"}),
        make_event(2, "p/close", Role.GRASP),
        make_event(3, "p/detach", Role.RELEASE, numbers={"object": "can", "position_m": [0.6, 0.3, 0.03]}),
        make_event(4, "p/locate", Role.SENSE, numbers={"object": "red_cube"}),
    )
    bundle = make_bundle(make_world(), Stage.CLOSED)
    for trace, stage in ((made, Stage.BEFORE), ((*made, *bundle.trace), Stage.CLOSED)):
        timeline = ManipulationTimeline.of(msgspec.structs.replace(bundle, trace=trace), "red_cube")
        assert (timeline.stage, timeline.since_release_m) == (stage, 0.0)


def ask(bundle: Bundle):
    return diagnose(bundle, [evaluate_criterion(text, "accept", bundle) for text in bundle.session.accept])


def moved(x: float = 0.4, y: float = 0.2, z: float = 0.02, **more: Any):
    return change(put(make_world(), "red_cube", (x, y, z)), "red_cube", **more)


COURSES = [
    (moved(x=0.9, z=-0.7), Stage.LIFTED, {"code": "GRASP_LOST"}, Cause.GRASP_LOST, CauseClass.TRANSPORT),
    (moved(), Stage.CLOSED, {"code": "GRASP_MISSED"}, Cause.OBJECT_MOVED, CauseClass.DISTURBANCE),
    (moved(), Stage.BEFORE, {"code": "NO_IK"}, Cause.OBJECT_MOVED, CauseClass.DISTURBANCE),
    (moved(), Stage.BEFORE, {"ended": Ended.STALLED}, Cause.OBJECT_MOVED, CauseClass.DISTURBANCE),
    (moved(y=0.31), Stage.CLOSED, {"code": "GRASP_MISSED"}, Cause.GRASP_MISSED, CauseClass.GRASP),
    (moved(), Stage.GRASPED, {"code": "GRASP_LOST"}, Cause.GRASP_LOST, CauseClass.GRASP),
    (moved(), Stage.LIFTED, {"code": "GRASP_LOST"}, Cause.GRASP_LOST, CauseClass.TRANSPORT),
    (moved(x=1.6, z=-0.7), Stage.BEFORE, {"code": "NO_IK"}, Cause.OBJECT_GONE, CauseClass.DISTURBANCE),
    (moved(0.6, 0.4), Stage.RELEASED, {"ended": Ended.COMPLETED}, Cause.PLACED_WRONG, CauseClass.PLACEMENT),
    (moved(0.3, -0.3), Stage.RELEASED, {"ended": Ended.COMPLETED}, Cause.OBJECT_MOVED, CauseClass.DISTURBANCE),
    (make_world(), Stage.BEFORE, {"code": "POLICY_LOST"}, Cause.POLICY_FAILED, CauseClass.POLICY),
    (
        make_world(),
        Stage.BEFORE,
        {"ended": Ended.SAFETY_STOP, "code": "TARGET_LIMIT"},
        Cause.ADAPTER_REFUSED,
        CauseClass.ADAPTER,
    ),
    (
        make_world(),
        Stage.BEFORE,
        {"code": "WRONG_SHAPE", "leaf": "policy"},
        Cause.POLICY_FAILED,
        CauseClass.POLICY,
    ),
    (make_world(), Stage.BEFORE, {"code": "NOT_FINITE", "leaf": "policy"}, Cause.POLICY_FAILED, CauseClass.POLICY),
    (
        moved(visible=False),
        Stage.BEFORE,
        {"code": "OBSERVATION_UNAVAILABLE", "leaf": "policy"},
        Cause.SENSOR_STALE,
        CauseClass.PERCEPTION,
    ),
    (make_world(), Stage.BEFORE, {"code": "RATE", "leaf": "policy"}, Cause.ADAPTER_REFUSED, CauseClass.ADAPTER),
    (make_world(), Stage.BEFORE, {"ended": Ended.RUNNER_LOST}, Cause.RUNNER_LOST, CauseClass.MACHINE),
]


@pytest.mark.parametrize(("after", "stage", "execution", "cause", "kind"), COURSES)
def test_each_course_has_its_cause_and_class(after, stage, execution, cause, kind):
    diagnosis = ask(make_bundle(after, stage, **execution))
    assert (diagnosis.cause, diagnosis.kind) == (cause, kind)


STOPPED = {"ended": Ended.SAFETY_STOP}
TAKEN_ALONG = (0.3, 0.0, 0.5)
GONE = remove(make_world(), "red_cube")


@pytest.mark.parametrize(
    ("after", "stage", "execution", "cause", "hopeless"),
    [
        pytest.param(
            moved(x=0.9, z=-0.7),
            Stage.LIFTED,
            {"code": "GRASP_LOST"},
            Cause.GRASP_LOST,
            True,
            id="a slip off the table",
        ),
        pytest.param(
            moved(*TAKEN_ALONG, held_by="panda"),
            Stage.GRASPED,
            {"code": "MOTION_CONFLICT"},
            None,
            False,
            id="what a hand took along as it gave way to another robot is not gone",
        ),
        pytest.param(
            moved(*TAKEN_ALONG), Stage.GRASPED, {"code": "MOTION_CONFLICT"}, None, True, id="what no hand holds is"
        ),
        pytest.param(
            moved(z=-0.2, confidence=0.4),
            Stage.CLOSED,
            {"code": "GRASP_MISSED"},
            Cause.OBJECT_MOVED,
            False,
            id="nothing is given up for a pose that is not sure",
        ),
        pytest.param(
            make_world(),
            Stage.LIFTED,
            STOPPED | {"code": "LEASE_LOST"},
            Cause.RUNNER_LOST,
            False,
            id="a stop for want of a lease is the machine's",
        ),
        pytest.param(
            make_world(),
            Stage.LIFTED,
            STOPPED | {"code": "DEADMAN"},
            Cause.STALLED,
            False,
            id="a stop for want of a command is the machine's",
        ),
        pytest.param(
            GONE, Stage.BEFORE, {"code": "GRASP_MISSED"}, Cause.OBJECT_GONE, True, id="an absent object is gone"
        ),
        pytest.param(
            GONE, Stage.LIFTED, {"code": "GRASP_LOST"}, Cause.GRASP_LOST, False, id="but not once it was taken hold of"
        ),
    ],
)
def test_what_another_attempt_cannot_mend_is_given_up_and_nothing_else(after, stage, execution, cause, hopeless):
    diagnosis = ask(make_bundle(after, stage, **execution))
    assert (diagnosis.cause, diagnosis.is_hopeless) == (cause or diagnosis.cause, hopeless)
    assert execution.get("ended") is not Ended.SAFETY_STOP or diagnosis.kind is CauseClass.MACHINE


@pytest.mark.parametrize("x", [0.9, 1.4])
def test_what_closed_fingers_push_is_not_moved_by_somebody_else(x):
    """A cube that was pushed by 0.8 m was `carried off without being held`, and given up."""
    bundle = make_bundle(moved(x=x), Stage.CLOSED, ended=Ended.COMPLETED)
    pushed = (make_event(0, "p/plan_push", Role.PLAN), *bundle.trace[1:], make_event(5, "p/push", Role.MOVE))
    assert ask(msgspec.structs.replace(bundle, trace=pushed)).cause is Cause.PLACED_WRONG


def test_what_a_lost_runner_may_have_carried_is_not_given_up_as_taken_away():
    bundle = make_bundle(moved(0.3, 0.0, 0.5), ended=Ended.RUNNER_LOST, code="RUNNER_LOST")
    assert ask(bundle).is_hopeless  # its trace tells that the hand had not closed
    diagnosis = ask(msgspec.structs.replace(bundle, trace=()))
    assert (diagnosis.cause, diagnosis.is_hopeless) == (Cause.RUNNER_LOST, False)


@pytest.mark.parametrize(("code", "hopeless"), [("TARGET_LOST", True), ("HOST_LOST", False)])
def test_what_was_lost_with_its_host_is_worth_another_attempt_where_another_host_has_its_target(code, hopeless):
    bundle = make_bundle(make_world(), ended=Ended.TARGET_LOST, code=code)
    diagnosis = ask(msgspec.structs.replace(bundle, before=None, after=None, trace=()))
    assert (diagnosis.cause, diagnosis.is_hopeless) == (Cause.TARGET_LOST, hopeless)


def criterion(text: str, truth: Truth, kind: str = "accept", **more: Any) -> Criterion:
    return Criterion(text=text, kind=kind, truth=truth, because="seen so", **more)


IN_TRAY = criterion("inside(red_cube, red_tray)", Truth.TRUE)
DEFECT = criterion("level(red_cube)", Truth.UNKNOWN, failure="BROKEN_PYTHON")


@pytest.mark.parametrize(
    ("defect", "criteria"),
    [
        ("skills/x/behaviours.py:7", [IN_TRAY, criterion("visible(red_cube)", Truth.FALSE)]),
        ("", [IN_TRAY, DEFECT]),
        ("", [criterion("visible(red_cube)", Truth.FALSE), DEFECT]),
    ],
)
def test_an_error_of_a_persons_code_is_the_cause_and_no_other_attempt_helps(defect, criteria):
    bundle = make_bundle(
        moved(0.6, 0.3), ended=Ended.SKILL_FAILED, code="LEAF_ERROR", message="KeyError", defect=defect
    )
    diagnosis = diagnose(bundle, criteria)
    assert (diagnosis.cause, diagnosis.is_hopeless) == (Cause.BROKEN_PYTHON, True)
    assert diagnosis.fact


JUDGING = [
    ([IN_TRAY, criterion("not inside(red_cube, red_tray)", Truth.FALSE)], Cause.CRITERIA_CONTRADICT),
    (
        [
            criterion("visible(red_cube) and not inside(red_cube, red_tray)", Truth.TRUE),
            criterion("inside(red_cube, red_tray)", Truth.FALSE),
        ],
        Cause.CRITERIA_CONTRADICT,
    ),
    ([IN_TRAY, criterion(IN_TRAY.text, Truth.FALSE, "vision")], Cause.JUDGES_DISAGREE),
    (
        [IN_TRAY, criterion(IN_TRAY.text, Truth.UNKNOWN, "vision", failure="MODEL_FAILED")],
        Cause.JUDGE_FAILED,
    ),
    ([IN_TRAY, criterion("scorer", Truth.UNKNOWN, "scorer", failure="JUDGE_FAILED")], Cause.JUDGE_FAILED),
]


@pytest.mark.parametrize(("criteria", "cause"), JUDGING)
def test_a_verdict_that_its_own_judges_prevent_is_the_verifiers(criteria, cause):
    diagnosis = diagnose(make_bundle(moved(0.6, 0.3), Stage.RELEASED, ended=Ended.COMPLETED), criteria)
    assert (diagnosis.cause, diagnosis.kind) == (cause, CauseClass.VERIFIER)
    assert diagnosis.fact
    assert diagnosis.is_hopeless is (cause is Cause.CRITERIA_CONTRADICT)


@pytest.mark.parametrize(
    "criteria",
    [
        [IN_TRAY, criterion(IN_TRAY.text, Truth.UNKNOWN, "vision")],
        [
            criterion(IN_TRAY.text, Truth.FALSE),
            criterion(IN_TRAY.text, Truth.UNKNOWN, "vision", failure="MODEL_FAILED"),
        ],
        [IN_TRAY, criterion("not moved(red_cube)", Truth.FALSE, "hold")],
        [criterion("inside(red_cube, red_tray) or not inside(red_cube, blue_tray)", Truth.FALSE)],
    ],
)
def test_what_the_world_or_the_pictures_prevent_is_not_the_verifiers(criteria):
    diagnosis = diagnose(make_bundle(moved(0.6, 0.3), Stage.RELEASED, ended=Ended.COMPLETED), criteria)
    assert diagnosis.kind is not CauseClass.VERIFIER


def test_the_numbers_that_support_a_cause_name_their_file_and_field():
    support = ask(make_bundle(moved(), Stage.CLOSED, code="GRASP_MISSED")).support
    told = {(each.file, each.field): each.value for each in support}
    assert told["execution.json", "code"] == "GRASP_MISSED"
    assert told["trace.jsonl", "stage"] == "closed"
    assert told["environment_before.json", "entities.red_cube.pose.position_m"] == "0.400, 0.300, 0.020"
    assert told["environment_after.json", "entities.red_cube.pose.position_m"] == "0.400, 0.200, 0.020"


def test_what_alone_is_not_seen_after_two_looks_is_gone_and_what_nobody_sees_is_hidden():
    after = moved(visible=False)
    bundle = make_bundle(after, Stage.BEFORE, ended=Ended.COMPLETED)
    criteria = [evaluate_criterion("inside(red_cube, red_tray)", "accept", bundle)]
    assert diagnose_after_looking(bundle, criteria).cause is Cause.OBJECT_GONE
    dark = {n: msgspec.structs.replace(e, visible=not e.movable) for n, e in after.entities.items()}
    bundle = make_bundle(msgspec.structs.replace(after, entities=dark), Stage.BEFORE, ended=Ended.COMPLETED)
    assert diagnose_after_looking(bundle, criteria).cause is Cause.OBJECT_HIDDEN


def test_where_every_camera_is_frozen_the_verdict_says_so_and_not_that_the_skill_did_nothing():
    after = make_world()
    health = SensorHealth(status="frozen", detail="its own count of exposures stands")
    after = msgspec.structs.replace(after, time_s=after.time_s + 1.3, sensors={"left": health, "top": health})
    bundle = msgspec.structs.replace(make_bundle(after, ended=Ended.COMPLETED), after=after)
    criteria = [evaluate_criterion(text, "accept", bundle) for text in ("visible(red_cube)", "on(red_cube, table)")]
    assert [each.truth for each in criteria] == [Truth.UNKNOWN, Truth.UNKNOWN]
    said = "left, top are frozen (its own count of exposures stands)"
    for found in (diagnose(bundle, criteria), diagnose_after_looking(bundle, criteria)):
        assert (found.cause, said in found.fact) == (Cause.SENSOR_STALE, True), found
    one = msgspec.structs.replace(after, sensors={"left": SensorHealth(), "top": health})
    assert (one.sees, one.describe_cameras()) == (True, "top is frozen (its own count of exposures stands)")


def test_what_a_star_covers_is_missing_evidence_unless_all_of_it_was_seen():
    told = criterion("not moved(*)", Truth.UNKNOWN)
    bundle = make_bundle(make_world(), ended=Ended.COMPLETED)
    assert diagnose(bundle, [told]).cause is Cause.UNDECIDABLE
    after = change(make_world(), "blue_cube", visible=False)
    assert diagnose(msgspec.structs.replace(bundle, after=after), [told]).cause is Cause.EVIDENCE_MISSING


_APART_M = 0.02  # the cube from the middle of its tray


@pytest.mark.parametrize(
    ("text", "stds_m", "least", "bounds", "looser"),
    [
        ("centred(red_cube, red_tray, 0.022)", (0.001, 0.003), "red_tray", "6 2", "centred(red_cube, red_tray, 0.027)"),
        (
            "centred(red_cube, red_tray, 0.022)",
            (0.004, 0.003),
            "red_cube",
            "8 0.8",
            "centred(red_cube, red_tray, 0.033)",
        ),
        (
            "distance(red_cube, red_tray) > 0.019",
            (0.001, 0.003),
            "red_tray",
            "6 2",
            "distance(red_cube, red_tray) > 0.014",
        ),
        ("on(red_cube, red_tray)", (0.001, 0.003), "red_tray", "6 5", "above(red_cube, red_tray)"),
        ("centred(red_cube, red_tray)", (0.001, 0.006), "red_tray", "12 9", "centred(red_cube, red_tray, 0.033)"),
        (
            "centred(red_cube, red_tray, 0.0204)",
            (0.001, 0.0005),
            "red_cube",
            "2 0.2",
            "centred(red_cube, red_tray, 0.026)",
        ),
        ("centred(red_cube, red_tray, 0.022)", (0.0, 0.0), "", "", ""),
    ],
)
def test_a_verdict_that_nothing_decided_names_what_would_decide_it(text, stds_m, least, bounds, looser):
    x, y, _ = make_world().entities["red_tray"].pose.position_m
    after = put(make_world(), "red_cube", (x + _APART_M, y, 0.03))
    for name, std_m in zip(("red_cube", "red_tray"), stds_m, strict=True):
        after = change(after, name, position_std_m=std_m, turn_std_rad=0.0)
    bundle = msgspec.structs.replace(make_bundle(after, ended=Ended.COMPLETED), before=after, after=after)
    found = diagnose(bundle, [criterion(text, Truth.UNKNOWN)])
    assert found.cause is Cause.UNDECIDABLE
    known, _, needed = bounds.partition(" ")
    said = f"; {least} is known to ±{known} mm and ±0°, the criterion needs ±{needed} mm and ±0°"
    view = f": another view of {least} (by a camera of sensors.yaml), or"
    said += f"{', which no view measures:' if needed == '0.2' else view} the criterion {looser}"
    said += ", or another support would decide it" if least == "red_tray" else " would decide it"
    assert found.fact == f"{text} is unknown: seen so{said if least else ''}"


def test_what_a_hand_still_held_as_the_session_began_is_neither_moved_nor_gone_when_it_falls():
    bundle = make_bundle(moved(z=0.02), Stage.CLOSED, code="GRASP_MISSED")
    before = moved(z=0.3, status=Status.HELD, held_by="panda")
    diagnosis = ask(msgspec.structs.replace(bundle, before=before))
    assert (diagnosis.cause, diagnosis.is_hopeless) == (Cause.GRASP_MISSED, False)
