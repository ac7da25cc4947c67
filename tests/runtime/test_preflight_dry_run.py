"""A dry run rejects what is proved impossible, and nothing else."""

from multiprocessing import Pipe
from threading import Thread
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.sessions.evidence import BEFORE
from phyagentos.protocol.sessions.session import Scene, Session
from phyagentos.protocol.world.environment import Entity, Environment, Interior, Pose, Shape, ShapeKind, TargetState
from phyagentos.runtime.actions.tool_point import ToolPoint
from phyagentos.runtime.channel import Link
from phyagentos.runtime.codec import Codec
from phyagentos.runtime.execution.first_motions import Foreseen, Grasp, Home
from phyagentos.runtime.execution.leaf import Leaf, PortInformation, Role
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.requests import (
    GRASPS,
    Approach,
    Approaches,
    CheckPosture,
    Destination,
    FindGrasps,
    FindPlacements,
    NoPlan,
    PostureCheck,
    Timing,
    World,
)
from phyagentos.runtime.preflight.adapter_plan import AdapterPlan
from phyagentos.runtime.preflight.dry_run import (
    ANSWER_S,
    DryRun,
    Reach,
    compute_reach,
    find_motions,
)
from phyagentos.runtime.preflight.examination import Examiner
from phyagentos.runtime.targets.wire import Kinematics
from phyagentos.runtime.worker.orders import Check, Checked, Ready, Reconcile, encode, receive_answer, serve_refusals
from phyagentos.testing import ManualClock

HOME = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
WAY = Approach(label="yaw+000", tcp_end=Pose((0.5, 0.0, 0.02)), line_rad=np.tile(HOME, (3, 1)))
FOUND = Approaches(approaches=(WAY,), timing=Timing(ms={}))
SESSION = Session(
    id="g.a", goal="g", node="a", objective="o", skill="pick_and_place", target="panda", accept=(), seed=0,
    parameters={"object": "cube", "destination": "tray"}, scene=Scene(name="s", seed=0, episode="e"),
)  # fmt: skip


class Oracle:
    """A planner that answers what it was told to, by kind of request."""

    def __init__(self, **answers) -> None:
        free = PostureCheck(contacts=(), escapes=True, timing=Timing(ms={}))
        self.answers, self.asked, self.waiting = {"CheckPosture": free, **answers}, [], None

    def submit(self, request) -> None:
        self.waiting = self.answers.get(type(request).__name__)
        if not isinstance(request, CheckPosture):
            self.asked.append(request)

    def poll(self):
        return self.waiting

    def wait(self, timeout_s) -> bool:
        return True


REGISTRY = build_registry(Library.open())


def refuse(code, **rejected):
    return NoPlan(code=code, message="no", timing=Timing(ms={}), rejected=rejected)


def make_world(cube=(0.5, 0.0, 0.02), q_rad=HOME, **of_cube):
    state = TargetState(q_rad=tuple(q_rad), qd_rad_s=(0.0,) * 7, gripper_width_m=0.08, tcp=Pose())
    entities = {
        "cube": Entity(name="cube", kind="cube", pose=Pose(cube), **of_cube),
        "tray": Entity(
            name="tray", kind="tray", pose=Pose((0.4, 0.3, 0.0)), interior=Interior((0.0, 0.0, 0.05), (0.1, 0.1, 0.05))
        ),
    }
    return Environment(
        time_s=0.0, scene="s", episode="e", revision=1, sensing="truth", entities=entities, regions={},
        targets={"panda": state},
    )  # fmt: skip


def try_out(planner, cube=(0.5, 0.0, 0.02), reach=None, thorough=False, clock=None, tree="pick_and_place", q_rad=HOME):
    now = make_world(cube, q_rad)
    clock = clock or ManualClock()
    dry_run = DryRun(
        planner=planner, library=Library.open(), registry=REGISTRY, clock=clock, home_rad=HOME, reach=reach
    )
    return dry_run.run(SESSION, tree, now, thorough=thorough)


def test_the_first_motions_of_a_tree_are_found_through_its_subtrees():
    arguments = {"object": "cube", "destination": "tray", "near": [0.4, 0.1, 0.0]}

    motions = list(find_motions("pick_and_place", arguments, Library.open(), REGISTRY))

    then = Destination("tray", "inside", (0.4, 0.1, 0.0))
    room, grasp = "pick_and_place/make_room/plan_room", "pick_and_place/pick/plan_grasp"
    assert motions == [Grasp("cube", room, then, removable=()), Grasp("cube", grasp, then), then]
    assert list(find_motions("stack", {"object": "a", "support": "b"}, Library.open(), REGISTRY))[1].relation == "on"
    assert list(find_motions("home", {}, Library.open(), REGISTRY)) == [Home()]
    assert list(find_motions("nowhere", {}, Library.open(), REGISTRY)) == []


@pytest.mark.parametrize("near", [[0.4, 0.1], ["left", 0.1, 0.0], 0.4])
def test_a_place_near_what_is_no_point_is_not_tried(near):
    arguments = {"object": "cube", "destination": "tray", "near": near}

    assert list(find_motions("pick_and_place", arguments, Library.open(), REGISTRY)) == [
        Grasp("cube", "pick_and_place/pick/plan_grasp")
    ]


def test_what_a_fallback_may_never_reach_is_not_tried(tmp_path):
    tree = """
tree: cautious
description: d
inputs: {object: {type: entity}}
root:
  sequence:
    children:
      - fallback: {children: [{condition: "visible(${object})"}, wait]}
      - subtree: {tree: pick, with: {object: $object}}
"""
    (tmp_path / "trees").mkdir()
    (tmp_path / "trees/cautious.yaml").write_text(tree, encoding="utf-8")

    assert list(find_motions("cautious", {"object": "cube"}, Library.open(tmp_path), REGISTRY)) == []


def test_what_follows_a_subtree_that_was_not_looked_through_is_not_tried(tmp_path):
    (tmp_path / "trees").mkdir()
    (tmp_path / "trees" / "push_and_pick.yaml").write_text(
        "tree: push_and_pick\ndescription: Bring it within reach, then take it.\ninputs:\n"
        "  object: {type: entity, description: x.}\n  to: {type: point, description: x.}\n"
        "root:\n  sequence:\n    children:\n      - subtree: {tree: push, with: {object: $object, to: $to}}\n"
        "      - subtree: {tree: pick, with: {object: $object}}\n"
    )
    arguments = {"object": "cube", "to": (0.4, 0.0, 0.02)}
    assert list(find_motions("push_and_pick", arguments, Library.open(tmp_path), REGISTRY)) == []


class Scoop(Leaf):
    """Takes hold in a way that no leaf which ships knows."""

    ROLE = Role.PLAN_GRASP
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="What to scoop.")}


class Lever(Leaf):
    """As `Scoop`, by another port."""

    ROLE = Role.PLAN
    INPUT_PORTS = {"bottom": PortInformation(data_type=str, description="What to lift.")}

    @classmethod
    def foresee(cls, wired, path):
        return Foreseen(Grasp(wired["bottom"], path))


@pytest.mark.parametrize(("leaf", "port"), [(Scoop, "object"), (Lever, "bottom")])
def test_a_grasp_of_a_leaf_that_does_not_ship_is_tried_like_one_that_does(tmp_path, leaf, port):
    tree = f"""
tree: scoop
description: d
inputs: {{object: {{type: entity}}, destination: {{type: place}}}}
root:
  sequence:
    children:
      - locate: {{object: $object}}
      - take: {{{port}: $object}}
      - plan_place: {{payload: $payload, destination: $destination}}
"""
    (tmp_path / "trees").mkdir()
    (tmp_path / "trees/scoop.yaml").write_text(tree, encoding="utf-8")
    registry = build_registry(Library.open())
    registry.register("take", leaf)

    arguments = {"object": "cube", "destination": "tray"}
    motions = list(find_motions("scoop", arguments, Library.open(tmp_path), registry))

    assert motions == [Grasp("cube", "scoop/take"), Destination("tray")]


def test_a_motion_that_was_found_is_possible_and_the_place_is_asked_for_with_its_grasp():
    planner = Oracle(FindGrasps=FOUND, FindPlacements=FOUND)

    trials = try_out(planner)

    assert [trial.outcome for trial in trials] == ["possible", "possible"]
    grasp, place = planner.asked
    assert isinstance(grasp, FindGrasps)
    assert isinstance(place, FindPlacements)
    assert (grasp.count, place.count) == (GRASPS, 1)  # as the skill asks; one place is enough
    assert place.payload.entity == "cube"


def test_a_grasp_that_leads_on_needs_no_further_question_about_the_place():
    planner = Oracle(FindGrasps=msgspec.structs.replace(FOUND, leads_on=True))

    trials = try_out(planner)

    assert [(trial.motion, trial.outcome) for trial in trials] == [
        ("grasp cube", "possible"), ("place cube inside tray", "possible"),
    ]  # fmt: skip
    assert [type(each) for each in planner.asked] == [FindGrasps]


def test_the_skill_asks_for_its_grasp_as_its_preflight_did(build_bench, build_session, library, registry):
    bench, session, oracle = build_bench(), build_session(), Oracle(FindGrasps=FOUND, FindPlacements=FOUND)
    bench.run(session)
    now = msgspec.json.decode((bench.workspace / "evidence" / session.id / BEFORE).read_bytes(), type=Environment)
    clock, home = ManualClock(), now.targets["panda"].q_rad
    dry_run = DryRun(planner=oracle, library=library, registry=registry, clock=clock, home_rad=home, reach=None)

    dry_run.run(session, "pick_and_place", now, thorough=False)

    (asked,) = (each for each in oracle.asked if isinstance(each, FindGrasps))
    encode_request = Codec[FindGrasps](FindGrasps, "request").encode
    assert encode_request(asked) in map(
        encode_request, (r for r in bench.planner.requests if isinstance(r, FindGrasps))
    )


@pytest.mark.parametrize(
    ("answer", "outcome", "code"),
    [
        (refuse("NOT_GRASPABLE"), "impossible", "NOT_GRASPABLE"),
        (refuse("NO_IK", ik=40), "impossible", "OUT_OF_REACH"),
        (refuse("NO_IK", **{"ik": 39, "hand|workspace_box": 1}), "impossible", "OUT_OF_REACH"),
        (refuse("NO_IK", **{"hand|keep_out.column": 40, "occupied": 9}), "impossible", "OUT_OF_REACH"),
        (refuse("NO_IK", ik=40, occupied=9), "undecided", "NO_IK"),
        (refuse("NO_IK", **{"hand|workspace_box": 39, "hand|wall": 1}), "undecided", "NO_IK"),
        (refuse("NO_IK", ik=39, line=1), "undecided", "NO_IK"),
        (refuse("NO_IK"), "undecided", "NO_IK"),
        (refuse("IN_COLLISION"), "undecided", "IN_COLLISION"),
        (refuse("RUNNER_LOST"), "undecided", "RUNNER_LOST"),
        (refuse("CANCELLED"), "undecided", "CANCELLED"),
    ],
)
def test_only_a_proof_makes_a_grasp_impossible(answer, outcome, code):
    (trial,) = try_out(Oracle(FindGrasps=answer))

    assert (trial.outcome, trial.code) == (outcome, code)


def test_a_path_that_was_not_found_is_no_proof():
    planner = Oracle(
        FindGrasps=FOUND, PlanMove=refuse("NOT_GRASPABLE"), FindPlacements=FOUND, TimeLine=refuse("REQUEST_INVALID")
    )

    assert [trial.outcome for trial in try_out(planner, thorough=True)[1:]] == ["possible", "undecided", "possible"]


class Silent(Oracle):
    """A planner that never answers, on a clock that goes on meanwhile."""

    def __init__(self, clock) -> None:
        super().__init__()
        self.clock, self.cancelled = clock, False

    def wait(self, timeout_s) -> bool:
        self.clock.advance(timeout_s)
        return False

    def cancel(self) -> None:
        self.cancelled = True


def test_a_planner_that_does_not_answer_in_time_decides_nothing():
    clock = ManualClock()
    planner = Silent(clock)

    (trial,) = try_out(planner, clock=clock)

    assert trial.outcome == "undecided"
    assert planner.cancelled
    assert trial.ms == pytest.approx(1e3 * ANSWER_S)


def test_what_lies_beyond_the_reach_is_not_even_asked_for():
    planner = Oracle()

    (trial,) = try_out(planner, cube=(3.0, 0.0, 0.0), reach=Reach((0.0, 0.0, 0.333), 1.0))

    assert (trial.outcome, trial.code) == ("impossible", "OUT_OF_REACH")
    assert planner.asked == []


def test_no_posture_reaches_beyond_the_bound():
    rng = np.random.default_rng(0)
    for _ in range(20):
        n = int(rng.integers(1, 8))
        axes = rng.normal(size=(n, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        anchors, tcp = rng.uniform(-1.0, 1.0, (n, 3)), rng.uniform(-1.0, 1.0, 3)
        kinematics = Kinematics(
            axes=tuple(map(tuple, axes.tolist())), anchors_m=tuple(map(tuple, anchors.tolist())), tcp_m=tuple(tcp)
        )
        reach, tool = compute_reach(kinematics), ToolPoint(kinematics)
        excess = [reach.compute_excess(tool.compute(q)) for q in rng.uniform(-np.pi, np.pi, (200, n))]
        assert max(excess) < 1e-9


def examine(now, planner, *sessions):
    """What preflight finds of these sessions, one after the other, in a world that stands still."""
    library, clear = Library.open(), lambda *_, **__: []
    skill = SimpleNamespace(skill="pick_and_place", kind="builtin", loop=None, tree="pick_and_place")
    plan = AdapterPlan(target_adapter="t", skill_runtime="s", tree=skill.tree, observation_path=(), action_path=())
    preflight = SimpleNamespace(
        skills={"pick_and_place": skill}, profile=read_target(library.get_target("panda")), plan=lambda *_: (plan, ()),
        find_contract_problems=clear, find_target_problems=clear, find_scene_problems=clear, find_world_problems=clear,
    )  # fmt: skip
    handle = SimpleNamespace(
        describe=lambda: SimpleNamespace(kinematics=None, procedures=()), load=lambda *_, **__: None
    )
    examiner = Examiner(
        preflight=preflight, handle=handle, world=SimpleNamespace(enter=lambda _: None, observe=lambda _: now),
        planner=planner, library=library, registry=REGISTRY, clock=ManualClock(),
    )  # fmt: skip
    return [examiner.examine(session) for session in sessions]


def make_session(attempt=0, **changes):
    scene = Scene(name="tabletop/cubes_and_trays", seed=0, episode="e")
    return replace(SESSION, scene=scene, attempt=attempt, accept=("inside(cube, tray)",), **changes)


@pytest.mark.parametrize("leads_on", [False, True])
@pytest.mark.parametrize(
    ("kind", "size_m", "turn", "outcome"),
    [
        (ShapeKind.SPHERE, (0.03,), (1.0, 0.0, 0.0, 0.0), "impossible"),
        (ShapeKind.BOX, (0.03, 0.03, 0.03), (0.6, 0.0, 0.0, 0.8), "possible"),
        (ShapeKind.CYLINDER, (0.03, 0.04), (1.0, 0.0, 0.0, 0.0), "possible"),
        (ShapeKind.CYLINDER, (0.03, 0.04), (0.5**0.5, 0.5**0.5, 0.0, 0.0), "impossible"),  # it lies
    ],
)
def test_nothing_stands_on_what_has_no_level_face_also_where_a_grasp_leads_on(kind, size_m, turn, outcome, leads_on):
    world = make_world()
    base = Entity(name="tray", kind="base", pose=Pose((0.4, 0.3, 0.03), turn), shapes=(Shape(kind, size_m),))
    now = replace(world, entities=world.entities | {"tray": base})
    planner = Oracle(FindGrasps=replace(FOUND, leads_on=leads_on), FindPlacements=FOUND)
    dry_run = DryRun(
        planner=planner, library=Library.open(), registry=REGISTRY, clock=ManualClock(), home_rad=HOME, reach=None
    )
    session = replace(SESSION, parameters={"object": "cube", "support": "tray"})
    place = dry_run.run(session, "stack", now, thorough=False)[-1]

    assert (place.motion, place.outcome) == ("place cube on tray", outcome)
    assert place.code == ("NO_SPACE" if outcome == "impossible" else "")


def test_every_attempt_passes_the_same_dry_run():
    planner = Oracle(FindGrasps=FOUND, FindPlacements=refuse("NO_FREE_SITE"))
    found = examine(make_world(), planner, make_session(), make_session(1), make_session(2))

    assert [[problem.code for problem in each.problems] for each in found] == [["NO_FREE_SITE"]] * 3


@pytest.mark.parametrize(
    ("more", "is_moved"), [({}, True), ({"kept": ("can",)}, False), ({"hold": ("not moved(*)",)}, False)]
)
def test_what_the_tree_moves_out_of_the_destination_is_no_obstacle(more, is_moved):
    now = make_world()
    can = Entity(name="can", kind="can", pose=Pose((0.4, 0.3, 0.02)))
    now = replace(now, entities=now.entities | {"can": can})
    planner = Oracle(FindGrasps=replace(FOUND, gone=("can",)), FindPlacements=FOUND)
    dry_run = DryRun(
        planner=planner, library=Library.open(), registry=REGISTRY, clock=ManualClock(), home_rad=HOME, reach=None
    )
    dry_run.run(replace(SESSION, **more), "pick_and_place", now, thorough=False)

    assert [each.removable for each in planner.asked[:-1]] == [("can",)] * is_moved + [()]
    assert all(("can" in {e.name for e in each.world.entities}) is not is_moved for each in planner.asked[is_moved:])


def test_where_an_object_lies_once_it_is_let_go_is_not_known_beforehand():
    (found,) = examine(make_world(held_by="panda"), Oracle(FindGrasps=refuse("NOT_GRASPABLE")), make_session(1))

    assert [trial.motion for trial in found.trials] == []
    assert found.plan is not None


@pytest.mark.parametrize(
    ("cube", "speed_m_s", "refused", "asks"),
    [
        ((0.4, 0.3, 0.05), 0.0, "ALREADY_MET", False),
        ((0.4, 0.3, 0.05), 0.1, "NOT_GRASPABLE", True),  # it may come to rest where it is wanted
        ((0.5, 0.0, 0.02), 0.0, "", True),
    ],
)
def test_what_may_be_met_already_is_granted_for_a_look(cube, speed_m_s, refused, asks):
    planner = Oracle(FindGrasps=refuse("NOT_GRASPABLE"))
    (found,) = examine(make_world(cube, speed_m_s=speed_m_s), planner, make_session(unless_met=True))

    assert bool(planner.asked) is asks
    assert [problem.code for problem in (found.plan.refused if refused else found.problems)] == [
        refused or "NOT_GRASPABLE"
    ]


def test_an_arm_with_a_slide_has_no_such_bound():
    anchors = ((0.0, 0.0, 0.0),)
    slide = Kinematics(axes=((0.0, 0.0, 1.0),), anchors_m=anchors, tcp_m=(0.0, 0.0, 1.0), slides=(True,))

    assert compute_reach(slide) is None


def test_joints_that_only_turn_in_place_do_not_lengthen_the_reach():
    up, side = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    anchors = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.3), (0.0, 0.0, 0.7))
    reach = compute_reach(Kinematics(axes=(up, side, side), anchors_m=anchors, tcp_m=(0.0, 0.0, 1.0)))

    assert reach.center_m == (0.0, 0.0, 0.3)
    assert reach.radius_m == pytest.approx(0.7)


def test_a_worker_whose_settings_cannot_be_read_refuses_every_session_with_the_reasons():
    ours, theirs = Pipe()
    control = Link(ours)
    problem = Problem(code="MISSING_VALUE", address="safety.yaml:9:5", found="'tbd'")
    thread = Thread(target=serve_refusals, args=(Link(theirs), [problem]))
    thread.start()

    assert isinstance(receive_answer(control), Ready)
    control.send_bytes(encode(Check(session=SESSION, epoch=1)))
    answer = receive_answer(control)
    assert isinstance(answer, Checked)
    assert answer.plan is None
    assert answer.problems[0].address == "g.a: safety.yaml:9:5"
    control.send_bytes(
        encode(Reconcile(session=SESSION, epoch=2, evidence="e", reason="r"))
    )  # nothing that it could do
    thread.join(5.0)
    assert not thread.is_alive()


def touch(*contacts, escapes):
    return PostureCheck(contacts=contacts, escapes=escapes, timing=Timing(ms={}))


def test_a_start_in_contact_is_found_and_rejects_only_where_there_is_no_way_out():
    stuck, leaning = (
        try_out(Oracle(CheckPosture=touch("link5|wall", escapes=escapes), FindGrasps=FOUND, FindPlacements=FOUND))[0]
        for escapes in (False, True)
    )

    assert (stuck.motion, stuck.outcome, stuck.code) == ("start posture", "impossible", "IN_COLLISION")
    assert stuck.message == "in this posture link5|wall touch"
    assert (leaning.outcome, leaning.code) == ("undecided", "IN_COLLISION")
    assert leaning.message.endswith("there is a way out")


class Blocked(Oracle):
    """The posture called home touches a wall, every other one is free."""

    def submit(self, request) -> None:
        super().submit(request)
        if isinstance(request, CheckPosture) and np.allclose(request.q_rad, HOME):
            self.waiting = touch("link5|wall", escapes=True)


def test_a_home_posture_that_touches_what_cannot_be_moved_is_rejected_unless_the_arm_is_there():
    away, there = (
        [(trial.motion, trial.outcome) for trial in try_out(Blocked(), tree="home", q_rad=q_rad)]
        for q_rad in (np.array(HOME) + 0.2, HOME)
    )

    assert away == [("home posture", "impossible")]
    assert there == [("start posture", "undecided")]


@pytest.mark.motion
def test_the_planner_tells_what_a_posture_touches_and_whether_it_can_leave():
    planner = MotionPlanner.open(Library.open().get_target("panda"))
    beside = Entity(
        name="wall", kind="wall", movable=False, pose=Pose((0.4, 0.0, 0.5)),
        shapes=(Shape(ShapeKind.BOX, (0.05, 0.3, 0.5)),),
    )  # fmt: skip
    ask = lambda *entities, **more: planner.answer(  # noqa: E731
        CheckPosture(world=World(entities), q_rad=np.array(HOME), seed=0, **more)
    )

    assert ask().contacts == ()
    blocked = ask(beside)
    assert any(pair.endswith("|wall") for pair in blocked.contacts)
    assert ask(beside, ignore=("wall",)).contacts == ()
