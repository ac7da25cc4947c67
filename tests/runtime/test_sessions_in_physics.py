"""Whole sessions on contact physics, with real planning: the outcome is read from the simulator, not from the skill."""

import json

import msgspec
import mujoco
import numpy as np
import pytest

from phyagentos.agent.judging.judges.metrics import HoldJudge
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence import read_bundle
from phyagentos.protocol.sessions.session import Ended, GoalId, Scene, SessionId
from phyagentos.protocol.world.faults import FaultFile
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector, draw_schedule
from phyagentos.runtime.drivers.mujoco.joint_controller import JointController
from phyagentos.runtime.drivers.mujoco.stride import NO_STRIDE
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget

pytestmark = [pytest.mark.sim, pytest.mark.motion]


@pytest.fixture(scope="module")
def planner(library):
    return MotionPlanner.open(library.get_target("panda"))


@pytest.fixture
def build_world(build_bench, library, profile, planner):
    """A runner on a fresh simulated world, with faults or without."""

    def build(*faults):
        folder = library.get_target("panda").parent
        file = FaultFile(version=1, faults=faults)
        shared = SimulatedWorld(library, faults=lambda *episode: FaultInjector(draw_schedule(file, *episode)))
        driver = MujocoDriver(shared, profile, folder)
        world = ServedTarget(driver, ReceiveLog(None))
        return build_bench(target=world, planner=LocalPlanner(planner), clock=SystemClock())

    return build


@pytest.fixture
def build(build_session):
    def build(skill, seed, number=0, **parameters):
        return build_session(
            id=SessionId(f"tidy-{seed}.{number}"),
            goal=GoalId(f"tidy-{seed}"),
            skill=skill,
            parameters=parameters,
            seed=seed,
            scene=Scene(name="tabletop/cubes_and_trays", seed=seed, episode=f"tidy-{seed}"),
        )

    return build


def load_terminal(folder):
    """The recorded world after a session, from the bundle's own files and MuJoCo alone."""
    model = mujoco.MjModel.from_binary_path(str(folder / evidence.SCENE_MODEL))
    data = mujoco.MjData(model)
    with np.load(folder / evidence.TERMINAL) as arrays:
        mujoco.mj_setState(model, data, arrays["state"], mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_forward(model, data)
    return data


TO_RED = {"object": "red_cube", "destination": "red_tray"}
TO_GREEN = {"object": "green_cube", "destination": "green_tray"}


def is_in_tray(data, cube, tray):
    dx, dy, dz = data.body(cube).xpos - data.body(tray).xpos
    return abs(dx) < 0.06 and abs(dy) < 0.09 and 0.0 < dz < 0.05


GENTLE = "metric(peak_force_n) <= 10"


def judge_gently(bench, session):
    execution = bench.run(session)
    bundle = read_bundle(bench.workspace / execution.evidence, session, execution)
    (held,) = HoldJudge().judge(bundle)
    return execution, held


def test_a_cube_is_picked_and_ends_in_its_tray_put_down_softly(build_world, build):
    bench = build_world()
    session = msgspec.structs.replace(build("pick_and_place", 2, **TO_RED), hold=(GENTLE,))
    execution, held = judge_gently(bench, session)

    assert execution.ended is Ended.COMPLETED, execution
    data = load_terminal(bench.workspace / execution.evidence)
    assert is_in_tray(data, "red_cube", "red_tray")
    assert execution.outputs["place_site"] == pytest.approx(data.body("red_cube").xpos, abs=0.003)
    assert (held.truth, held.evidence) == (Truth.TRUE, evidence.TRAJECTORY), held
    check_that_solvers_are_named(bench.workspace / execution.evidence)


def check_that_solvers_are_named(folder):
    """Every answer of the planner says in the bundle which stage solved it."""
    events = map(json.loads, (folder / evidence.EVENTS).read_text().splitlines())
    answers = [(event["code"], event["details"]["stages"]) for event in events if event["kind"] == "planner"]
    assert {code for code, _ in answers} == {"Approaches", "Motion"}
    for code, stages in answers:
        if code == "Approaches":
            assert all(0 < goal["hover"]["iterations"] < 10 for goal in stages["goals"] if "hover" in goal)
            assert all(goal["hover"]["position_error_m"] < 1e-7 for goal in stages["goals"] if "hover" in goal)
        else:
            solved = {"toppra": "Ok", "casadi": "solved"}  # what is carried is shaped where it is heavy
            assert stages["scaling"]["status"] == solved[stages["scaling"]["solver"]]
            assert (stages["scaling"]["solver"] == "casadi") <= ("unshaped_grip_share" in stages["scaling"])
            assert stages.get("path", {}).get("planner", "") in ("", "straight", "OMPL RRT-Connect")
    assert any("grip_share" in stages.get("scaling", {}) for _, stages in answers)


@pytest.fixture
def falls(monkeypatch):
    """Cube -> the longest way down that it went without touching a finger [m], by the physics engine's own state."""
    longest, began = {}, {}
    sense = JointController._sense

    def watch(controller):
        sense(controller)
        touching = controller._physics.queries.find_touching()
        for name in ("red_cube", "green_cube"):
            height = float(controller._physics.queries.find_position(name)[2])
            began[name] = height if name in touching else max(began.get(name, height), height)
            longest[name] = max(longest.get(name, 0.0), began[name] - height)

    monkeypatch.setattr(JointController, "_sense", watch)
    monkeypatch.setattr(JointController, "_stride", lambda _controller, _controls: NO_STRIDE)  # every step is watched
    return longest


@pytest.mark.parametrize(
    ("skill", "parameters"),
    [
        ("pick_and_place", TO_RED),
        ("pick_and_place", TO_GREEN),
        ("push", {"object": "red_cube", "to": [0.45, -0.1, 0.0]}),
    ],
)
def test_what_an_earlier_session_holds_is_set_down_not_dropped(build_world, build, falls, skill, parameters):
    bench = build_world()
    for number, (before, given) in enumerate([("pick", {"object": "green_cube"}), ("home", {})]):
        assert bench.run(build(before, 6, number, **given)).ended is Ended.COMPLETED
    after = bench.run(build(skill, 6, 2, **parameters))

    assert after.ended is Ended.COMPLETED, after
    assert max(falls.values()) < 0.01, falls  # 40 cm, when the hand opened where it was
    data = load_terminal(bench.workspace / after.evidence)
    if skill == "pick_and_place":
        color, _, _ = parameters["object"].partition("_")
        assert is_in_tray(data, f"{color}_cube", f"{color}_tray")
    else:
        assert data.body("red_cube").xpos == pytest.approx(parameters["to"], abs=0.03)
    if parameters is not TO_GREEN:
        assert data.body("green_cube").xpos[2] == pytest.approx(0.02, abs=0.002)
        assert not any(is_in_tray(data, "green_cube", f"{color}_tray") for color in ("red", "green", "blue"))


SEIZED = {"kind": "stall", "object": "green_cube", "when": {"lifted_m": 0.1}}


def test_the_attempt_after_a_failed_one_sets_down_what_that_held_and_takes_it_again(build_world, build, falls):
    bench = build_world(SEIZED)
    failed, again = (bench.run(build("pick_and_place", 11, number, **TO_GREEN)) for number in (0, 1))

    assert (failed.ended, again.ended) == (Ended.STALLED, Ended.COMPLETED), (failed.message, again.leaf, again.message)
    assert load_terminal(bench.workspace / failed.evidence).body("green_cube").xpos[2] > 0.1, "it is held"
    assert is_in_tray(load_terminal(bench.workspace / again.evidence), "green_cube", "green_tray")
    assert falls["green_cube"] < 0.02, falls  # set down, not dropped from where it was held


def test_what_slips_out_while_it_is_set_down_leaves_the_hand_free_for_the_next_object(build_world, build):
    bench = build_world({"kind": "slip", "object": "green_cube", "when": {"session": "*.2"}})
    for number, (before, given) in enumerate([("pick", {"object": "green_cube"}), ("home", {})]):
        assert bench.run(build(before, 6, number, **given)).ended is Ended.COMPLETED
    session = build("pick_and_place", 6, 2, **TO_RED)
    after = bench.run(session)

    assert after.ended is Ended.COMPLETED, after
    trace = read_bundle(bench.workspace / after.evidence, session, after).trace
    assert "GRASP_LOST" in {event.code for event in trace}
    assert is_in_tray(load_terminal(bench.workspace / after.evidence), "red_cube", "red_tray")


def test_a_drawer_that_is_closed_already_is_seen_to_be_and_left_alone(build_world, build):
    bench = build_world()
    scene = Scene(name="tabletop/drawer", seed=3, episode="tidy-3")
    names = {"drawer": "drawer", "handle": "handle"}
    session = msgspec.structs.replace(build("close_drawer", 3, **names), scene=scene)
    shut = bench.run(session)
    assert shut.ended is Ended.COMPLETED, shut

    session = msgspec.structs.replace(build("close_drawer", 3, 1, **names), scene=scene)
    again = bench.run(session)
    assert (again.ended, again.code) == (Ended.COMPLETED, ""), again
    trace = read_bundle(bench.workspace / again.evidence, session, again).trace
    done = [event.leaf for event in trace if event.status == "SUCCESS"]
    assert "look" in done, "it is judged by what was seen"
    assert not {"close_gripper", "move_linear"} & set(done)


def test_a_level_transport_keeps_the_vessel_upright(build_world, build):
    bench = build_world()
    session = build("carry_level", 31, object="green_cube", destination="green_tray")
    execution = bench.run(session)

    assert execution.ended is Ended.COMPLETED, execution
    trace = read_bundle(bench.workspace / execution.evidence, session, execution).trace
    (carried,) = [event for event in trace if event.leaf == "move_level" and event.status == "SUCCESS"]
    assert carried.numbers["worst_tilt_rad"] <= 0.08 < carried.numbers["unshaped_worst_tilt_rad"]


def test_a_session_whose_object_is_pulled_at_ends_and_is_judged_by_its_force(build_world, build):
    bench = build_world({"kind": "move", "object": "red_cube", "when": {"lifted_m": 0.03}})
    session = build("pick_and_place", 2, object="red_cube", destination="red_tray")
    execution, held = judge_gently(bench, msgspec.structs.replace(session, hold=(GENTLE,)))

    assert (execution.ended, execution.code) == (Ended.SAFETY_STOP, "CONSTRAINT_VIOLATED"), execution
    assert (held.truth, held.measured["peak_force_n"] > 10) == (Truth.FALSE, True), held
