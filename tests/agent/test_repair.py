"""Which way a repair takes, and why: alternatives by effect on synthetic cases, with the shipped skills."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from benchmarks.recovery_parts.baselines import BlindRetry, FullRestart, NoRetry
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.selector import Choice
from phyagentos.agent.goals.spec import Budget
from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.repair.alternative import Alternative, AlternativeKind
from phyagentos.agent.repair.case import Case, RemainingBudget, UnmetObjective, compute_left
from phyagentos.agent.repair.other_means import propose_other_skill
from phyagentos.agent.repair.recovery_policies import GraphRepair
from phyagentos.agent.repair.retrying import propose_retry
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.sessions.session import Ended, Execution, Session, SessionId, SessionStatus
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.world.environment import (
    Entity,
    Environment,
    Interior,
    Pose,
    Region,
    Shape,
    ShapeKind,
    Status,
    TargetState,
)
from phyagentos.testing import make_world

from .conftest import change, make_table, put
from .test_verifier import failed, make_bundle, make_session

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def shipped() -> Catalogue:
    return Catalogue.read(Library((ROOT,)))


def make_box(name: str, position: tuple[float, float, float], half: float = 0.02, **more: Any) -> Entity:
    shapes = more.pop("shapes", (Shape(kind=ShapeKind.BOX, size_m=(half, half, half)),))
    return Entity(name=name, kind="cube", pose=Pose(position_m=position), shapes=shapes, **more)


def make_table_world(*objects: Entity) -> Environment:
    arm = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.08, tcp=Pose())
    return make_world(
        *(msgspec.structs.replace(each, observed_at_s=10.0) for each in (make_table(), *objects)),
        time_s=10.0,
        episode="g",
        regions={"zone": Region(name="zone", pose=Pose(position_m=(0.5, -0.3, 0.04)), half_m=(0.08, 0.08, 0.06))},
        targets={"panda": arm},
    )


def make_contract(**more: Any) -> Session:
    parameters = {"object": "red_cube", "destination": "zone"}
    facts = {"accept": ("inside(red_cube, zone)",), "requires": ("visible(red_cube)",), "parameters": parameters}
    return make_session(**(facts | more))


def make_case(catalogue: Catalogue, cause: Cause, **more: Any) -> Case:
    session = more.pop("session", make_contract(**more.pop("contract", {})))
    world = more.pop("world", PLAIN)
    missing = more.pop("missing", ())
    attempt = Attempt(verdict=Verdict.REPLAN, criteria=(), cause=cause.value, reason="r", missing_evidence=missing)
    execution = failed(more.pop("code", "NO_IK"), "a/plan") | {"is_final": more.pop("is_final", False)}
    bundle = make_bundle(world, session=session, before=world, execution=execution, trace=more.pop("trace", ()))
    status = SessionStatus(contract=session, state="verifying")
    facts: dict[str, Any] = {
        "miss": UnmetObjective.of_execution(bundle, attempt),
        "choice": Choice(skill="pick_and_place", target="panda", parameters=session.parameters),
        "catalogue": catalogue,
        "lineage": (*more.pop("earlier", ()), status, *more.pop("later", ())),
        "replans_left": 2,
        "left": RemainingBudget(),
        "time_of": {},
    }
    return Case(**(facts | more))


def met(name: str, count: int = 9) -> tuple[TraceEvent, ...]:
    """The planner met this object in the way."""
    numbers = {"rejected": {f"hand|{name}": count, "ik": 2}}
    return (TraceEvent(tick=1, time_s=1.0, path="a/plan", leaf="plan_grasp", status="FAILURE", numbers=numbers),)


def failed_before(session: Session, number: int, cause: Cause) -> SessionStatus:
    contract = msgspec.structs.replace(session, id=SessionId(f"{session.id}.r{number}"))
    attempt = Attempt(verdict=Verdict.REPLAN, criteria=(), cause=cause.value)
    return SessionStatus(contract=contract, state="replanned", attempts=(attempt,))


PLAIN = make_table_world(make_box("red_cube", (0.5, 0.0, 0.02)))
POST = make_box("post", (0.55, 0.0, 0.03), 0.03)
HEMMED = make_table_world(make_box("red_cube", (0.5, 0.0, 0.02)), POST)


TO_TRAY = {"parameters": {"object": "red_cube", "destination": "tray"}, "accept": ("inside(red_cube, tray)",)}
HEMMED_IN: dict[str, Any] = {"trace": met("post"), "world": HEMMED, "contract": TO_TRAY}


def test_what_is_in_the_way_is_moved_away_first_by_a_skill_that_promises_a_place(shipped):
    decision = GraphRepair().choose(make_case(shipped, Cause.NO_PLAN, **HEMMED_IN))
    revision = decision.chosen.revision
    assert (decision.chosen.kind, revision.purpose, revision.choice.skill) == (CLEAR, "clear", "set_aside")
    assert {"object": "post", "support": "table"}.items() <= revision.choice.parameters.items()
    assert any("the planner met post in the way" in reason for reason in decision.reasons)
    assert any(reason.startswith("rather than retry") for reason in decision.reasons)


def shift(world: Environment, name: str, by_m: float) -> Environment:
    x, y, z = world.entities[name].pose.position_m
    return put(world, name, (x + by_m, y, z))


def make_event(leaf: str, status: str = "SUCCESS", path: str = "a/b", **numbers: Any) -> TraceEvent:
    return TraceEvent(tick=1, time_s=1.0, path=path, leaf=leaf, status=status, numbers=numbers)


RETRY, GIVE_UP, CLEAR = AlternativeKind.RETRY, AlternativeKind.GIVE_UP, AlternativeKind.CLEAR
OTHER_SKILL, OTHER_GRASP = AlternativeKind.OTHER_SKILL, AlternativeKind.OTHER_GRASP
LOOKS = tuple(
    SessionStatus(
        contract=make_contract(id=SessionId(f"g.red.r{n}"), skill="inspect", purpose="inspect"), state="replanned"
    )
    for n in (1, 2)
)
PLACING = (  # the object was taken and lifted, and no way to its place was found
    make_event("plan_grasp", labels=["yaw+000", "yaw+090"]),
    make_event("move_to", label="yaw+000"),
    make_event("close_gripper"),
    make_event("verify_grasp"),
    make_event("plan_place", "FAILURE", "a/plan"),
)
ROUTE_BLOCKED = (make_event("plan_place", labels=["site1.yaw+000"]), make_event("move_to", "FAILURE", "a/carry"))
PUT_ASIDE = (make_event("plan_place", labels=["site4.yaw+000"]), make_event("move_to", label="site4.yaw+000"))
NO_GRASP = (make_event("plan_grasp", "FAILURE", "a/plan"),)


def propose(case: Case) -> Alternative:
    return GraphRepair((propose_retry,)).choose(case).chosen


@pytest.mark.parametrize(
    ("facts", "kind"),
    [
        pytest.param({"code": "MOTION_CONFLICT"}, RETRY, id="a plan that another robot was in the way of"),
        pytest.param({"code": "NO_IK"}, GIVE_UP, id="a plan that found nothing in the same world"),
        pytest.param(
            {"trace": NO_GRASP, "contract": {"strategy": Strategy(avoid_sites=("s",), speed=0.5)}},
            GIVE_UP,
            id="a grasp that was not found does not depend on sites and speed",
        ),
        pytest.param(
            {"trace": NO_GRASP, "contract": {"strategy": Strategy(avoid_grasps=("yaw+000",))}},
            RETRY,
            id="it depends on the grasps that are left out",
        ),
        pytest.param({"trace": PLACING}, OTHER_GRASP, id="the grasp reaches no place"),
        pytest.param({"trace": PLACING, "code": "NO_FREE_SITE"}, GIVE_UP, id="no grasp reaches a place that is full"),
        pytest.param(
            {"trace": PLACING[:-1] + ROUTE_BLOCKED}, OTHER_GRASP, id="no path leads from the grasp to its place"
        ),
        pytest.param({"trace": PUT_ASIDE + PLACING}, OTHER_GRASP, id="the second grasp reaches no place"),
        pytest.param(
            {"trace": PUT_ASIDE + PLACING[:-1] + ROUTE_BLOCKED}, OTHER_GRASP, id="no path from the second one"
        ),
        pytest.param({"trace": PLACING[:1] + ROUTE_BLOCKED[1:]}, GIVE_UP, id="no path to the grasp itself"),
    ],
)
def test_where_no_plan_was_found_what_the_trace_shows_decides_what_is_tried(shipped, facts, kind):
    chosen = propose(make_case(shipped, Cause.NO_PLAN, **facts))
    assert chosen.kind is kind
    assert kind is not OTHER_GRASP or chosen.revision.strategy == Strategy(avoid_grasps=("yaw+000",))


@pytest.mark.parametrize(
    ("cause", "trace", "moved", "kind"),
    [
        (Cause.NO_PLAN, (), ("red_cube", 0.0), GIVE_UP),
        (Cause.NO_PLAN, (), ("red_cube", 0.1), RETRY),
        (Cause.NO_PLAN, (), ("post", 0.1), RETRY),
        (Cause.NO_PLAN, (), ("post", 0.004), GIVE_UP),  # within what counts as not moved
        (Cause.NO_PLAN, PLACING, ("red_cube", 0.1), GIVE_UP),  # it was in the hand
        (Cause.ADAPTER_REFUSED, (), ("red_cube", 0.0), GIVE_UP),
        (Cause.IMPOSSIBLE, (), ("red_cube", 0.0), GIVE_UP),
        (Cause.GRASP_MISSED, (), ("red_cube", 0.0), RETRY),  # contacts differ
    ],
)
def test_a_plan_that_failed_is_not_tried_again_in_the_same_world(shipped, cause, trace, moved, kind):
    code = "NO_FREE_SITE" if trace else "NO_IK"
    case = make_case(shipped, cause, world=HEMMED, contract=TO_TRAY, trace=trace, code=code)
    assert propose(replace(case, miss=replace(case.miss, world=shift(HEMMED, *moved)))).kind is kind


@pytest.mark.parametrize(("is_final", "kind"), [(False, RETRY), (True, GIVE_UP)])
def test_a_failure_that_the_leaf_calls_final_is_not_repeated_by_the_same_skill(shipped, is_final, kind):
    case = make_case(shipped, Cause.GRASP_MISSED, contract=TO_TRAY, is_final=is_final)
    decision = GraphRepair((propose_retry,)).choose(case)
    assert decision.chosen.kind is kind
    assert any("another attempt would fail" in each for each in decision.reasons) is is_final


def test_a_policy_that_was_refused_is_asked_again_in_the_same_world(shipped):
    skill = shipped.skills["pick_and_place"].model_copy(update={"kind": "policy"})
    learned = Catalogue(skills={"pick_and_place": skill}, targets=shipped.targets, scenes={})
    for catalogue, kind in ((shipped, GIVE_UP), (learned, RETRY)):
        assert propose(make_case(catalogue, Cause.ADAPTER_REFUSED, contract=TO_TRAY)).kind is kind


POLICY = {"policy": "p/1", "endpoint": "tcp://127.0.0.1:1", "observations": {}, "inference_s": 0.1}


def learn(shipped: Catalogue, **execution: str) -> Catalogue:
    """The shipped skills; what picks and places is a policy with this execution."""
    policy = PolicyDescriptor.model_validate(POLICY | {"execution": execution})
    skill = shipped.skills["pick_and_place"].model_copy(update={"kind": "policy", "policy": policy})
    return replace(shipped, skills=shipped.skills | {"pick_and_place": skill})


@pytest.mark.parametrize("cause", [Cause.SAFETY_STOP, Cause.ADAPTER_REFUSED, Cause.WITHOUT_EFFECT])
def test_a_policy_begins_where_it_was_shown_to_before_it_is_tried_again(shipped, cause):
    learned = learn(shipped, begins_after="start_over")
    case = make_case(learned, cause, contract=TO_TRAY)
    chosen = GraphRepair((propose_retry,)).choose(case).chosen
    revision = chosen.revision
    assert (chosen.kind, chosen.sessions, revision.purpose) == (AlternativeKind.BEGIN_ANEW, 2, "clear")
    assert (revision.choice.skill, revision.choice.parameters) == ("start_over", {"object": "red_cube"})
    contract = msgspec.structs.replace(case.session, id=SessionId("g.red.r1"), skill="start_over", purpose="clear")
    begun = replace(case, lineage=(*case.lineage, SessionStatus(contract=contract, state="failed")))
    assert propose(begun).kind is RETRY, "it is not tried twice"
    spent = replace(case, replans_left=0)
    assert propose(spent).kind is GIVE_UP


@pytest.mark.parametrize("name", ["", "no_such_skill"])
def test_a_policy_that_names_no_beginning_is_tried_again_from_where_it_is(shipped, name):
    case = make_case(learn(shipped, begins_after=name), Cause.SAFETY_STOP, contract=TO_TRAY)
    assert propose(case).kind is RETRY


@pytest.mark.parametrize(
    ("missed", "moved_m", "aimed", "expected"),
    [
        ([0.02, -0.01, 0.03], 0.0, None, (0.02, -0.01, 0.0)),
        ([0.02, -0.01, 0.03], 0.0, (0.01, 0.01, 0.0), (0.03, 0.0, 0.0)),
        ([0.02, -0.01, 0.03], 0.05, None, None),  # it went along, or was pushed
        ([0.02, -0.01, 0.03], 0.05, (0.01, 0.01, 0.0), (0.01, 0.01, 0.0)),
        ([0.3, 0.1, 0.4], 0.0, None, None),  # it never came near
        ([0.3, 0.1, 0.4], 0.0, (0.01, 0.01, 0.0), (0.01, 0.01, 0.0)),
        (None, 0.0, None, None),
    ],
)
def test_a_policy_that_missed_an_object_is_shown_it_aside_by_as_much(shipped, missed, moved_m, aimed, expected):
    case = make_case(learn(shipped, aim="near"), Cause.SAFETY_STOP, contract=TO_TRAY)
    parameters = case.session.parameters | ({"near": aimed} if aimed else {})
    session = msgspec.structs.replace(case.session, parameters=parameters)
    outputs = {"missed_m": missed} if missed else {}
    execution = msgspec.structs.replace(case.miss.bundle.execution, outputs=outputs)
    after = shift(case.world, "red_cube", moved_m)
    bundle = msgspec.structs.replace(case.miss.bundle, session=session, execution=execution, after=after)
    missed_by = replace(case.miss, session=session, bundle=bundle, world=after)
    again = propose(replace(case, miss=missed_by)).revision.choice
    assert (again and again.parameters.get("near")) == (pytest.approx(expected) if expected else None)
    assert [each.startswith("near (") for each in again.reasons] == [True] if expected else again is None


def test_the_same_plan_is_found_again_behind_another_attempt(shipped):
    first, way = failed_before(make_contract(), 1, Cause.NO_PLAN), {"strategy": Strategy(avoid_grasps=("yaw+000",))}
    case = make_case(shipped, Cause.NO_PLAN, contract=way, earlier=(first,))
    assert propose(case).kind is RETRY  # in what world the first one was tried is not known
    known = replace(case, recall=lambda _: case.miss.bundle)
    assert propose(known).because.endswith("g.red.r1 ended with NO_PLAN in the same way, and the world is as it was")
    plain = make_case(shipped, Cause.NO_PLAN)
    refused = replace(plain, miss=replace(plain.miss, bundle=None))  # by preflight, in the world that was seen last
    assert propose(refused).kind is GIVE_UP


def test_a_refusal_is_no_repetition_once_a_preparation_has_moved_something(shipped):
    later = SessionStatus(
        contract=make_contract(id=SessionId("g.red.r1"), skill="set_aside", purpose="clear"), state="replanned"
    )
    case = make_case(shipped, Cause.NO_PLAN, world=HEMMED, later=(later,))
    case = replace(case, recall=lambda status: case.miss.bundle if status is later else None)
    refused = replace(case, miss=replace(case.miss, bundle=None))
    assert propose(refused).kind is GIVE_UP
    assert propose(replace(refused, miss=replace(refused.miss, world=shift(HEMMED, "post", 0.1)))).kind is RETRY


def make_full_tray(*on_top: Entity, **more: Any) -> dict[str, Any]:
    """A shallow tray, and a tall object in it, which leaves no room; other objects may be on that."""
    floor = (Shape(kind=ShapeKind.BOX, size_m=(0.07, 0.07, 0.0025)),)
    inside = Interior((0.0, 0.0, 0.01), (0.07, 0.07, 0.01))
    tray = make_box("tray", (0.5, 0.25, 0.0), shapes=floor, movable=False, interior=inside)
    tall = make_box("tall", (0.5, 0.25, 0.05), shapes=(Shape(kind=ShapeKind.BOX, size_m=(0.02, 0.02, 0.045)),))
    world = make_table_world(make_box("red_cube", (0.5, 0.0, 0.02)), tray, tall, *on_top)
    return {"world": world, "contract": TO_TRAY | more, "code": "NO_FREE_SITE"}


LOOK = {"skill": "inspect", "parameters": {"object": "red_cube"}, "accept": ("fallen(red_cube)",)}
TO_POINT = {"parameters": {"object": "red_cube", "to": [0.5, 0.2, 0.02]}}
UNSEEN = make_table_world(make_box("red_cube", (0.5, 0.0, 0.02), status=Status.HIDDEN))


def zone_of(half_m: float) -> dict[str, Any]:
    """The region in which the cube is to lie, of another size."""
    zone = Region(name="zone", pose=Pose(position_m=(0.5, -0.3, 0.04)), half_m=(half_m, half_m, 0.06))
    return {"world": msgspec.structs.replace(PLAIN, regions={"zone": zone})}


@pytest.mark.parametrize(
    ("cause", "facts", "kind", "choice", "because"),
    [
        pytest.param(
            Cause.NO_PLAN,
            HEMMED_IN | {"protected": frozenset({"post"})},
            GIVE_UP,
            (),
            "g.red ended with NO_PLAN in the same way, and the world is as it was",
            id="what a finished node has put there is left alone",
        ),
        pytest.param(
            Cause.NO_PLAN,
            make_full_tray(),
            CLEAR,
            ("set_aside", {"object": "tall"}),
            "",
            id="what fills a tray is moved out however tall it is",  # a box of 89 mm in a tray of 15 mm was not found
        ),
        pytest.param(
            Cause.NO_PLAN,
            make_full_tray(make_box("lid", (0.5, 0.25, 0.115)), make_box("knob", (0.5, 0.25, 0.155))),
            CLEAR,
            ("set_aside", {"object": "knob"}),
            "",
            id="what is on it goes first",
        ),
        pytest.param(
            Cause.NO_PLAN,
            make_full_tray() | {"protected": frozenset({"tall"})},
            CLEAR,
            ("set_aside", {"object": "tall"}),
            "",
            id="whichever node placed it",
        ),
        pytest.param(
            Cause.NO_PLAN, make_full_tray(hold=("not moved(tall)",)), GIVE_UP, (), "", id="but not against the goal"
        ),
        pytest.param(
            Cause.IMPOSSIBLE,
            {},
            OTHER_SKILL,
            ("push", {"object": "red_cube", "to": [0.5, -0.3, 0.04]}),
            "which covers inside(red_cube, zone)",
            id="an object too wide for the hand is pushed into the region",
        ),
        pytest.param(
            Cause.NO_PLAN,
            {"contract": TO_POINT | {"skill": "push"}, "choice": Choice(skill="push", target="panda", **TO_POINT)},
            OTHER_SKILL,
            ("put_at", TO_POINT["parameters"] | {"support": "table"}),
            "",
            id="what no push reaches is put there and stands on what it stood on",
        ),
        pytest.param(
            Cause.IMPOSSIBLE, zone_of(0.035), GIVE_UP, (), "", id="no push into a region smaller than its tolerance"
        ),
        pytest.param(  # 0.0399999…
            Cause.IMPOSSIBLE, zone_of(0.65 - 0.61), OTHER_SKILL, ("push", {}), "", id="a push into one as large as that"
        ),
        pytest.param(Cause.GRASP_MISSED, {}, RETRY, (), "", id="a grasp that failed once is tried again"),
        pytest.param(
            Cause.GRASP_MISSED,
            {"earlier": tuple(failed_before(make_contract(), number, Cause.GRASP_MISSED) for number in (1, 2))},
            OTHER_SKILL,
            ("push", {}),
            "",
            id="a grasp that keeps failing gives way to another skill",
        ),
        pytest.param(
            Cause.OBJECT_MOVED,
            {"left": RemainingBudget(sessions=1, needed=1)},
            GIVE_UP,
            (),
            "BUDGET",
            id="nothing is tried that cannot be paid at all",
        ),
    ],
)
def test_what_is_done_next_follows_from_the_cause_and_from_what_each_skill_brings_about(
    shipped, cause, facts, kind, choice, because
):
    chosen = GraphRepair().choose(make_case(shipped, cause, **facts)).chosen
    assert (chosen.kind, because in chosen.because) == (kind, True)
    if choice:
        skill, parameters = choice
        found = chosen.revision.choice
        assert (found.skill, found.parameters | parameters) == (skill, found.parameters)


@pytest.mark.parametrize(
    ("moved", "kind"),
    [
        (("red_cube", 0.0), GIVE_UP),
        (("post", 0.1), GIVE_UP),
        (("red_cube", 0.1), RETRY),
    ],
)
def test_a_claim_that_a_look_found_false_is_asked_again_only_of_another_world(shipped, moved, kind):
    own = Choice(skill="inspect", target="panda", parameters=LOOK["parameters"])
    case = make_case(shipped, Cause.WITHOUT_EFFECT, world=HEMMED, contract=LOOK, choice=own)
    ran = Execution(ended=Ended.COMPLETED, evidence="e", ticks=25)
    bundle = msgspec.structs.replace(case.miss.bundle, execution=ran)
    case = replace(case, miss=replace(case.miss, bundle=bundle, world=shift(HEMMED, *moved)))
    assert GraphRepair().choose(case).chosen.kind is kind


@pytest.mark.parametrize(
    ("cause", "world", "because"),
    [
        (Cause.UNDECIDABLE, PLAIN, "2 looks did not decide it"),
        (Cause.OBJECT_HIDDEN, UNSEEN, "2 looks have not shown that visible(red_cube)"),
    ],
)
def test_what_two_looks_did_not_decide_or_show_ends_there(shipped, cause, world, because):
    assert propose(make_case(shipped, cause, later=LOOKS[:1])).kind is RETRY
    chosen = propose(make_case(shipped, cause, later=LOOKS, world=world))
    assert (chosen.kind, because in chosen.because) == (GIVE_UP, True)


def test_another_way_to_clear_is_taken_when_the_first_one_did_not_help(shipped):
    tried = make_contract(
        id=SessionId("g.red.r1"), skill="set_aside", purpose="clear", parameters={"object": "post", "to": [0, 0, 0]}
    )
    later = (SessionStatus(contract=tried, state="verifying"),)
    chosen = GraphRepair().choose(make_case(shipped, Cause.NO_PLAN, **HEMMED_IN, later=later)).chosen
    assert (chosen.kind, chosen.revision.choice.skill, chosen.revision.parent) == (CLEAR, "push", "g.red.r1")


def test_the_same_that_failed_with_the_same_cause_is_worth_half(shipped):
    once, twice, other = (
        GraphRepair().choose(make_case(shipped, Cause.OBJECT_MOVED, earlier=earlier)).chosen.chance
        for earlier in ((), *((failed_before(make_contract(), 1, c),) for c in (Cause.OBJECT_MOVED, Cause.STALLED)))
    )
    assert (twice, other) == (once / 2, once)


def hold(world: Environment, name: str) -> Environment:
    arm = msgspec.structs.replace(world.targets["panda"], grip_force_n=30.0, holding=(name,))
    return msgspec.structs.replace(change(world, name, held_by="panda"), targets={"panda": arm})


HOLDING = hold(HEMMED, "red_cube")
NEAR = {"parameters": {"object": "red_cube", "destination": "zone", "near": [0.5, -0.3, 0.0]}}


@pytest.mark.parametrize("cause", [Cause.RUNNER_LOST, Cause.STALLED, Cause.TIMED_OUT])
def test_what_an_interrupted_session_left_in_the_hand_is_put_down_by_the_skill_that_begins_there(shipped, cause):
    decision = GraphRepair().choose(make_case(shipped, cause, world=HOLDING, contract=NEAR))
    revision = decision.chosen.revision
    assert revision.choice.skill == "place"
    assert revision.choice.parameters == NEAR["parameters"] | {"relation": "inside"}
    assert revision.requires == ("holding(target, red_cube)",)
    assert any("begins with what is held already" in reason for reason in decision.reasons)


@pytest.mark.parametrize("world", [HEMMED, hold(HEMMED, "post")])
def test_what_it_does_not_hold_is_fetched_again(shipped, world):
    for cause in (Cause.RUNNER_LOST, Cause.STALLED, Cause.TIMED_OUT):
        chosen = GraphRepair().choose(make_case(shipped, cause, world=world)).chosen
        assert (chosen.kind, chosen.revision.choice) == (RETRY, None)


@pytest.mark.parametrize("cause", [Cause.NO_PLAN, Cause.SAFETY_STOP, Cause.ADAPTER_REFUSED])
def test_where_the_way_in_which_it_is_held_may_be_at_fault_it_is_not_gone_on_with(shipped, cause):
    proposed = propose_other_skill(make_case(shipped, cause, world=HOLDING))
    assert not [each.effect for each in proposed if each.revision.lead]


@pytest.mark.parametrize("cause", [Cause.GRASP_LOST, Cause.NO_PLAN, Cause.PLACED_WRONG])
def test_a_remainder_that_fails_gives_the_node_back_to_its_own_skill(shipped, cause):
    parameters = {"object": "red_cube", "destination": "zone"}
    rest = make_contract(
        id=SessionId("g.red.r1"),
        skill="place",
        parameters=parameters | {"relation": "inside"},
        requires=("holding(target, red_cube)", "visible(red_cube)"),
    )
    own = Choice(skill="pick_and_place", target="panda", parameters=parameters)
    retry = next(propose_retry(make_case(shipped, cause, session=rest, choice=own)))
    assert (retry.revision.choice, retry.revision.requires) == (None, ("visible(red_cube)",))


def test_what_cannot_be_told_is_looked_at_first_and_no_more_than_twice(shipped):
    facts = {"cause": Cause.EVIDENCE_MISSING, "missing": ("red_cube",)}
    chosen = GraphRepair().choose(make_case(shipped, **facts)).chosen
    revision = chosen.revision
    assert (chosen.kind, revision.purpose, revision.choice.skill) == (AlternativeKind.LOOK, "inspect", "inspect")
    assert revision.lead > 0
    assert GraphRepair().choose(make_case(shipped, **facts, later=LOOKS)).chosen.kind is RETRY


def test_a_broken_arm_is_replaced_by_one_that_stands_in_the_same_world(shipped):
    twin = dict(shipped.targets)
    twin["twin"] = shipped.targets["panda"].model_copy(update={"target": "twin"})
    catalogue = Catalogue(skills=shipped.skills, targets=twin, scenes={})
    world = PLAIN
    both = msgspec.structs.replace(world, targets={**world.targets, "twin": world.targets["panda"]})
    earlier = (failed_before(make_contract(), 1, Cause.TARGET_LOST),)
    chosen = GraphRepair().choose(make_case(catalogue, Cause.TARGET_LOST, world=both, earlier=earlier)).chosen
    assert (chosen.kind, chosen.revision.choice.target) == (AlternativeKind.OTHER_TARGET, "twin")
    alone = make_case(catalogue, Cause.TARGET_LOST, world=world, earlier=earlier)
    assert GraphRepair().choose(alone).chosen.kind is RETRY


def test_a_way_that_the_budget_cannot_pay_is_passed_over_with_the_reason(shipped):
    left = RemainingBudget(sessions=2, needed=1)
    case = make_case(shipped, Cause.NO_PLAN, **HEMMED_IN, left=left)
    decision = GraphRepair().choose(case)
    assert decision.chosen.kind is GIVE_UP
    assert any(
        "BUDGET: 2 sessions are left, it takes 2 more and 1 for nodes not yet begun" in r for r in decision.reasons
    )


def test_the_four_policies_answer_the_same_case_each_in_its_own_way(shipped):
    case = make_case(shipped, Cause.GRASP_LOST, session=make_contract(strategy=Strategy(speed=0.5)))
    kinds = [policy.choose(case).chosen.kind for policy in (NoRetry(), BlindRetry(), FullRestart(), GraphRepair())]
    assert kinds == [GIVE_UP, RETRY, RETRY, RETRY]
    assert BlindRetry().choose(case).chosen.revision.strategy == Strategy(speed=0.5)
    assert GraphRepair().choose(case).chosen.revision.strategy == Strategy(speed=0.25)


def test_what_is_left_counts_sessions_and_simulated_time():
    ran = SessionStatus(
        contract=make_contract(),
        state="failed",
        execution=Execution(ended=Ended.COMPLETED, evidence="", sim_time_s=8.0),
    )
    left = compute_left(Budget(sessions=3, sim_time_s=20.0), [ran, ran], needed=1)
    assert (left.sessions, left.sim_time_s, left.needed) == (1, 4.0, 1)
    assert left.find_end() == ""
    assert compute_left(Budget(sessions=1), [ran]).find_end().startswith("BUDGET")
    assert compute_left(Budget(), [ran] * 9).find_excess(100, 1e6) == ""


def test_where_a_procedure_failed_another_skill_is_tried_but_not_with_a_value_that_it_refuses(shipped):
    case = make_case(shipped, Cause.UNKNOWN)
    choice = next(propose_other_skill(case)).revision.choice
    key = next(key for key, value in choice.parameters.items() if isinstance(value, str))
    skill = shipped.skills[choice.skill]
    narrow = skill.parameters[key].model_copy(update={"choices": ("something_else",)})
    refusing = skill.model_copy(update={"parameters": skill.parameters | {key: narrow}})
    case = replace(case, catalogue=replace(shipped, skills=shipped.skills | {choice.skill: refusing}))
    assert choice.skill not in {each.revision.choice.skill for each in propose_other_skill(case)}
