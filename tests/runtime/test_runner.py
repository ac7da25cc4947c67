"""The runner: whatever a skill does, the target is halted and observed, and evidence is left."""

import msgspec
import numpy as np
import pytest
import yaml

from phyagentos.protocol.predicates.library import PredicateDefinition, get_predicate_library
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence import read_bundle
from phyagentos.protocol.sessions.session import Ended, Limits
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.world.environment import Environment, Interior
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.execution.leaf import Leaf, Role, Status
from phyagentos.runtime.execution.loop import EndRequest
from phyagentos.runtime.targets import wire
from phyagentos.runtime.worker.orders import Reconcile


class Boast(Leaf):
    """Reports success and does nothing."""

    ROLE = Role.ACT

    def on_start(self):
        return self.succeed("everything went very well")


class Crash(Leaf):
    """Begins to move, then raises."""

    ROLE = Role.ACT

    def on_start(self):
        commands = self.context.commands
        rows = commands.q_rad + 2e-5 * np.arange(1, commands.n_steps + 1)[:, None]
        commands.set_arm(rows, np.full_like(rows, 0.01))
        return Status.RUNNING

    def on_running(self):
        raise ZeroDivisionError("by zero")


class Reckless(Leaf):
    """Commands a jump."""

    ROLE = Role.ACT

    def on_start(self):
        commands = self.context.commands
        rows = np.tile(commands.q_rad + 0.5, (commands.n_steps, 1))
        commands.set_arm(rows, np.zeros_like(rows))
        return Status.RUNNING


class Idle(Leaf):
    """Runs for ever without doing anything."""

    ROLE = Role.ACT

    def on_start(self):
        return Status.RUNNING

    def on_running(self):
        return Status.RUNNING


def was_halted(target):
    kinds = [type(request) for request in target.requests]
    last_command = max((i for i, kind in enumerate(kinds) if kind is wire.Command), default=-1)
    return wire.Halt in kinds[last_command + 1 :] and kinds[-1] is wire.End


def test_a_motion_is_planned_commanded_and_recorded(build_bench, build_session):
    bench = build_bench()
    bench.target.q = bench.target.q + 0.3
    execution = bench.run(build_session(skill="home", parameters={}))

    assert execution.ended is Ended.COMPLETED
    assert bench.target.q == pytest.approx(bench.target.profile.arm.home_rad)
    assert execution.ticks == len(bench.target.commands()) > 10
    assert was_halted(bench.target)


def test_a_session_that_opens_slowly_shows_signs_of_life_between_the_steps_of_it(build_bench, build_session):
    bench = build_bench()
    calls, fetch = bench.beats, bench.runner._handle.fetch_files
    bench.runner._handle.fetch_files = lambda *given: calls.append({"phase": "fetched"}) or fetch(*given)
    bench.run(build_session(skill="home", parameters={}))
    opening = [each["phase"] for each in calls][: [each["phase"] for each in calls].index("executing")]
    around = opening.index("fetched")
    assert opening[around - 1] == opening[around + 1] == "loading"
    assert opening.count("loading") >= 5


@pytest.fixture
def make_rolling(doubles):
    """Targets whose red cube rolls until they have settled for so long [s]."""

    class Rolling(doubles.PerfectTarget):
        def __init__(self, rolls_s, *given):
            super().__init__(*given)
            self.rolls_s = rolls_s

        def _observe(self):
            settles = [request.duration_s for request in self.requests if isinstance(request, wire.Settle)]
            speed_m_s = 0.1 if sum(settles) < self.rolls_s else 0.0
            self.entities["red_cube"] = msgspec.structs.replace(self.entities["red_cube"], speed_m_s=speed_m_s)
            return super()._observe()

    return Rolling


@pytest.mark.parametrize(
    ("rolls_s", "accept", "settled", "rests"),
    [
        (1.0, "on(red_cube, red_tray)", 4, True),
        (0.0, "on(red_cube, red_tray)", 1, True),
        (1.0, "on(blue_cube, red_tray)", 1, False),  # nothing of the acceptance moves
        (99.0, "on(red_cube, red_tray)", 8, False),
    ],
)
def test_the_look_at_the_end_waits_a_while_for_what_the_acceptance_speaks_of_to_rest(
    build_bench, build_session, doubles, profile, make_rolling, rolls_s, accept, settled, rests
):
    cubes = [doubles.make_cube(), doubles.make_cube("red_tray"), doubles.make_cube("blue_cube", (0.2, 0.2, 0.02))]
    bench = build_bench(make_rolling(rolls_s, profile, cubes))
    session = build_session(skill="home", parameters={}, accept=(accept,))
    execution = bench.run(session)

    assert sum(isinstance(request, wire.Settle) for request in bench.target.requests) == settled
    after = read_bundle(bench.workspace / execution.evidence, session, execution).after
    assert after.time_s == bench.target.time_s
    assert (not after.explain_motion(after.entities["red_cube"])) is rests


@pytest.mark.parametrize(
    ("cube", "rolls_s", "asked", "done"),
    [
        ((0.5, 0.3, 0.02), 0.0, True, "ALREADY_MET"),
        ((0.5, 0.3, 0.02), 0.5, True, "ALREADY_MET"),  # once it rests
        ((0.5, 0.3, 0.02), 99.0, True, ""),  # never shown to rest
        ((0.5, 0.3, 0.02), 0.0, False, ""),  # the action itself is wanted
        ((0.5, 0.0, 0.02), 0.0, True, ""),
    ],
)
def test_what_is_met_already_is_not_acted_on(
    build_bench, build_session, doubles, profile, make_rolling, cube, rolls_s, asked, done
):
    tray = doubles.make_cube("red_tray", (0.5, 0.3, 0.0), interior=Interior((0.0, 0.0, 0.05), (0.1, 0.1, 0.05)))
    bench = build_bench(make_rolling(rolls_s, profile, [doubles.make_cube(position_m=cube), tray]))
    bench.target.q = bench.target.q + 0.3
    accept = ("inside(red_cube, red_tray)", "not moved(red_tray)")
    session = build_session(skill="home", parameters={}, accept=accept, unless_met=asked)
    execution = bench.run(session)

    assert (execution.ended, execution.code) == (Ended.COMPLETED, done)
    assert (execution.ticks == 0) == (len(bench.target.commands()) == 0) == bool(done)


def test_what_preflight_granted_for_a_look_alone_never_acts(build_bench, build_session):
    bench = build_bench()
    bench.target.q = bench.target.q + 0.3
    refused = [{"code": "NOT_GRASPABLE", "address": "dry run", "found": "red_cube is wider than the gripper opens"}]
    execution = bench.run(build_session(skill="home", parameters={}), plan={"refused": refused})

    assert (execution.ended, execution.code, execution.ticks) == (Ended.SKILL_FAILED, "NOT_GRASPABLE", 0)
    assert "wider" in execution.message


def test_pick_and_place_runs_through_its_leaves_in_order(build_bench, build_session, doubles, gripping):
    bench, session = build_bench(gripping, doubles.ScriptedPlanner(polls=3)), build_session()
    execution = bench.run(session)

    assert execution.ended is Ended.COMPLETED, execution
    assert execution.outputs == {"place_site": [0.5, 0.0, 0.02]}
    trace = read_bundle(bench.workspace / execution.evidence, session, execution).trace
    done = [event.path.split("/", 1)[1] for event in trace if event.status == "SUCCESS" and event.path.count("/") == 2]
    assert done == [
        "free_hand/find_held", "free_hand/for_each", "make_room/plan_room", "make_room/for_each", "pick/free_hand",
        "pick/open_gripper", "pick/locate", "pick/plan_grasp", "pick/hover", "pick/preshape", "pick/lower",
        "pick/close_gripper", "pick/verify_grasp", "pick/lift", "pick/verify_lift", "place/attach",
        "place/plan_place", "place/carry", "place/verify_grasp", "place/lower", "place/open_gripper", "place/detach",
        "place/retreat",
    ]  # fmt: skip


def test_thinking_does_not_advance_simulated_time_and_leaves_no_trace(build_bench, build_session, doubles, profile):
    traces, commands = [], []
    for polls in (0, 50):
        cubes = [doubles.make_cube(), doubles.make_cube("red_tray", (0.5, 0.3, 0.0))]
        target = doubles.PerfectTarget(profile, cubes, graspable="red_cube")
        bench = build_bench(target, doubles.ScriptedPlanner(polls=polls))
        execution = bench.run(build_session())
        traces.append((bench.workspace / execution.evidence / evidence.TRACE).read_bytes())
        commands.append(np.vstack([command.q_rad for command in target.commands()]))
        assert (bench.planner.waits > 0) == (polls > 0)

    assert traces[0] == traces[1]
    assert np.array_equal(commands[0], commands[1])


def test_a_session_leaves_a_complete_bundle(build_bench, build_session, gripping):
    bench, session = build_bench(gripping), build_session(hold=("exists(red_tray)",))
    execution = bench.run(session)
    folder = bench.workspace / execution.evidence

    assert {path.name for path in folder.iterdir()} == {
        evidence.CONTRACT, evidence.SCENE_MODEL, evidence.SCENE_XML, evidence.INITIAL, evidence.TERMINAL,
        evidence.BEFORE, evidence.AFTER, evidence.TRACE, evidence.TRAJECTORY, evidence.EVENTS, evidence.HOLDS,
        evidence.FAULTS, evidence.FINGERPRINT, evidence.EXECUTION,
    }  # fmt: skip
    bundle = read_bundle(folder, session, execution)
    assert bundle.before.time_s == 0.0
    assert bundle.after.time_s > 1.0
    assert [(criterion.text, criterion.truth) for criterion in bundle.holds] == [("exists(red_tray)", "true")]
    contract = yaml.safe_load((folder / evidence.CONTRACT).read_text())
    assert contract["session"]["id"] == session.id
    assert contract["adapter_plan"] == {"tree": "pick_and_place"}
    with np.load(folder / evidence.TRAJECTORY) as arrays:
        assert arrays["q_commanded"].shape == arrays["q_measured"].shape == (execution.ticks, 7)
    with np.load(folder / evidence.INITIAL) as arrays:
        assert set(arrays.files) == {"state", "time", "qpos", "qvel", "act"}


def test_sessions_of_one_episode_share_the_scene_model(build_bench, session, plant):
    bench = build_bench(library=plant(["wait: {seconds: 0.1}"]))
    first = bench.run(session)
    second = bench.run(msgspec.structs.replace(session, id="tidy-1.blue"))

    one, other = (bench.workspace / each.evidence / evidence.SCENE_MODEL for each in (first, second))
    assert one.samefile(other)
    assert [getattr(request, "name", "") for request in bench.target.requests].count(wire.SCENE_MODEL) == 1


def test_leaves_that_report_success_and_move_nothing_complete_with_nothing_moved(build_bench, session, plant, registry):
    registry.register("boast", Boast)
    bench = build_bench(library=plant(["boast", "boast"]))
    execution = bench.run(session)

    assert (execution.ended, execution.ticks) == (Ended.COMPLETED, 0)
    folder = bench.workspace / execution.evidence
    before, after = (
        msgspec.json.decode((folder / name).read_bytes(), type=Environment)
        for name in (evidence.BEFORE, evidence.AFTER)
    )
    assert [e.pose for e in before.entities.values()] == [e.pose for e in after.entities.values()]


def test_a_leaf_that_raises_ends_the_session_with_its_path_and_the_target_halted(build_bench, session, plant, registry):
    registry.register("crash", Crash)
    bench = build_bench(library=plant(["crash"]))
    execution = bench.run(session)

    assert (execution.ended, execution.code) == (Ended.SKILL_FAILED, "LEAF_ERROR")
    assert execution.leaf == "planted/crash"
    assert "ZeroDivisionError: by zero" in execution.message
    place = f"{__file__}:{Crash.on_running.__code__.co_firstlineno + 1}"
    assert (execution.defect, place in execution.message) == (place, True)
    assert was_halted(bench.target)


@pytest.mark.parametrize(
    ("method", "error", "code", "is_defect"),
    [
        ("on_start", KeyError("gap"), "LEAF_ERROR", True),
        ("on_start", ConnectionError("bus"), "LEAF_ERROR", False),
        ("__init__", TypeError("no gripper"), "BROKEN_TREE", True),
    ],
)
def test_only_an_error_of_the_code_itself_is_its_defect(
    build_bench, session, plant, registry, method, error, code, is_defect
):
    def fail(*_):
        raise error

    registry.register("crash", type("Raises", (Boast,), {method: fail}))
    execution = build_bench(library=plant(["crash"])).run(session)
    place = f"{__file__}:{fail.__code__.co_firstlineno + 1}"
    assert (execution.code, execution.defect) == (code, place if is_defect else "")
    assert place in execution.message


def test_a_condition_of_the_tree_whose_predicate_raises_is_its_defect(build_bench, session, plant, monkeypatch):
    def measure(view):
        raise KeyError("gap")

    gap = PredicateDefinition(name="gap", arguments=(), measure=measure)
    monkeypatch.setitem(get_predicate_library()._definitions, "gap", gap)
    execution = build_bench(library=plant(["condition: gap()"])).run(session)
    assert execution.defect == f"{__file__}:{measure.__code__.co_firstlineno + 1}", execution


def test_a_leaf_says_that_its_failure_is_not_worth_another_attempt(build_bench, session, plant, registry):
    give_up = type("GiveUp", (Boast,), {"on_start": lambda self: self.fail_for_good("UNMET", "the lid is glued")})
    registry.register("give_up", give_up)
    execution = build_bench(library=plant(["give_up"])).run(session)
    assert (execution.ended, execution.code, execution.is_final) == (Ended.SKILL_FAILED, "UNMET", True)


def test_a_refused_command_never_reaches_the_wire_and_is_recorded(build_bench, session, plant, registry):
    registry.register("reckless", Reckless)
    bench = build_bench(library=plant(["reckless"]))
    execution = bench.run(session)

    assert (execution.ended, execution.code) == (Ended.SAFETY_STOP, "JOINT_VELOCITY")
    assert execution.interventions == 1
    assert bench.target.commands() == []
    assert was_halted(bench.target)
    events = read_bundle(bench.workspace / execution.evidence, session, execution).events
    (intervention,) = [event for event in events if event.kind == "intervention"]
    assert (intervention.code, intervention.details["where"]) == ("JOINT_VELOCITY", "joint 1")
    assert intervention.details["found"] > intervention.details["limit"]


def test_a_cancellation_halts_the_target_and_the_planner(build_bench, build_session, doubles):
    planner = doubles.ScriptedPlanner(polls=10**6)
    bench = build_bench(planner=planner)
    bench.target.q = bench.target.q + 0.3
    execution = bench.run(
        build_session(skill="home", parameters={}),
        cancel=lambda: EndRequest("cancelled") if planner.waits > 5 else None,
    )

    assert (execution.ended, execution.code) == (Ended.CANCELLED, "CANCELLED")
    assert planner.cancelled == 1
    assert was_halted(bench.target)


@pytest.mark.parametrize(
    ("timeout_s", "goal_left_s", "named"),
    [(0.5, 9.0, "the contract allows 0.5 s"), (60.0, 0.5, "BUDGET: the goal's budget leaves 0.5 s")],
)
def test_the_limit_that_decides_ends_a_session_and_is_named(build_bench, session, plant, timeout_s, goal_left_s, named):
    bench = build_bench(library=plant(["wait: {seconds: 100}"]))
    limits = Limits(timeout_s=timeout_s)
    execution = bench.run(msgspec.structs.replace(session, limits=limits, goal_left_s=goal_left_s))

    assert execution.ended is Ended.TIMED_OUT
    assert execution.message.startswith(named)
    assert len(bench.target.commands()) == 25


@pytest.mark.parametrize(
    ("reason", "why", "code", "named"),
    [
        ("timed_out", "the contract allows 9 s by the wall clock", "TIMED_OUT", "9 s by the wall"),
        ("stalled", "no command for 20 s although it acts", "STALLED", "20 s although"),
        ("cancelled", "", "CANCELLED", "requested"),
    ],
)
def test_an_end_by_the_watchdog_names_the_limit_that_decided(build_bench, session, plant, reason, why, code, named):
    bench = build_bench(library=plant(["wait: {seconds: 100}"]))
    execution = bench.run(session, cancel=lambda: EndRequest(reason, why))

    assert (execution.ended, execution.code) == (reason, code)
    assert named in execution.message


def test_a_tree_that_neither_moves_nor_thinks_is_stalled(build_bench, session, plant, registry):
    registry.register("idle", Idle)
    execution = build_bench(library=plant(["idle"])).run(session)

    assert (execution.ended, execution.code) == (Ended.STALLED, "STALLED")


def test_a_motor_that_does_not_follow_ends_the_session_as_stalled(build_bench, build_session):
    bench = build_bench()
    bench.target.q = bench.target.q + 0.5
    bench.target.stuck_joint = 2
    execution = bench.run(build_session(skill="home", parameters={}))

    assert (execution.ended, execution.code, execution.leaf) == (Ended.STALLED, "STALLED", "home/move_home")


def test_a_grasp_on_air_fails_with_its_code(build_bench, build_session):
    execution = build_bench().run(build_session())

    assert (execution.ended, execution.code) == (Ended.SKILL_FAILED, "GRASP_MISSED")
    assert execution.leaf == "pick_and_place/pick/verify_grasp"
    assert "press on nothing: no red_cube" in execution.message


def test_an_object_that_leaves_the_fingers_on_the_way_is_a_lost_grasp(build_bench, build_session, doubles, gripping):
    bench = build_bench(gripping)

    def drop(request):
        if "FindPlacements" in type(request).__name__:
            gripping.graspable = None
        return doubles.compute_answer(request)

    bench.planner._answer = drop
    execution = bench.run(build_session())

    assert (execution.ended, execution.code) == (Ended.SKILL_FAILED, "GRASP_LOST")
    assert execution.leaf == "pick_and_place/place/carry"
    assert was_halted(gripping)


@pytest.mark.parametrize(("closes", "ended"), [(False, Ended.COMPLETED), (True, Ended.SKILL_FAILED)])
def test_a_drive_that_is_shaken_has_lost_what_it_holds_only_once_its_fingers_close(
    build_bench, build_session, doubles, profile, closes, ended
):
    """A cube that touched the wall of its tray shook the fingers, whose current then showed nothing for 0.1 s."""

    class Shaken(doubles.PerfectTarget):
        left = 0  # observations

        def _state(self):
            state, self.left = super()._state(), self.left - 1
            force_n, width_m = (20.0, 0.0397) if state.holding else (0.0, state.gripper_width_m)
            if self.left > 0:
                state = msgspec.structs.replace(state, holding=())
                force_n, width_m = 0.0, 0.002 if closes else 0.0381
            return msgspec.structs.replace(state, grip_force_n=force_n, gripper_width_m=width_m)

    target = Shaken(profile, [doubles.make_cube(), doubles.make_cube("red_tray", (0.5, 0.3, 0.0))], "red_cube")
    bench = build_bench(target)

    def shake(request):
        if "FindPlacements" in type(request).__name__:
            target.left = 12
        return doubles.compute_answer(request)

    bench.planner._answer = shake
    execution = bench.run(build_session())

    assert (execution.ended, execution.code) == (ended, "GRASP_LOST" if closes else "")


def test_a_refusal_of_the_planner_is_the_leafs_failure(build_bench, build_session, doubles):
    bench = build_bench(planner=doubles.ScriptedPlanner(answer=doubles.refuse))
    session = build_session()
    execution = bench.run(session)

    assert (execution.code, execution.message) == ("NO_PLAN", "the wall is in the way")
    trace = read_bundle(bench.workspace / execution.evidence, session, execution).trace
    (failed,) = [event for event in trace if event.code == "NO_PLAN"]
    assert failed.numbers == {"rejected": {"ik": 3}}


def test_a_violated_hold_condition_stops_the_session(build_bench, session, plant):
    bench = build_bench(library=plant(["wait: {seconds: 5}"]))
    bench.target.entities.pop("red_cube")
    execution = bench.run(msgspec.structs.replace(session, hold=("exists(red_cube)",)))

    assert (execution.ended, execution.code) == (Ended.SAFETY_STOP, "CONSTRAINT_VIOLATED")
    assert (execution.ticks, execution.interventions) == (5, 1)


def test_a_hold_condition_whose_predicate_raises_ends_the_session_as_its_defect(
    build_bench, session, plant, monkeypatch
):
    def measure(view):
        return 1.0 / max(0.05 - view.now.time_s, 0.0)

    gap = PredicateDefinition(name="gap", arguments=(), measure=measure)
    monkeypatch.setitem(get_predicate_library()._definitions, "gap", gap)
    bench = build_bench(library=plant(["wait: {seconds: 5}"]))
    execution = bench.run(msgspec.structs.replace(session, hold=("gap()",)))

    assert execution.defect == f"{__file__}:{measure.__code__.co_firstlineno + 1}", execution
    assert (execution.code, execution.ticks) == ("BROKEN_PYTHON", 5)
    assert was_halted(bench.target)


def test_what_happens_while_the_arm_comes_to_rest_counts_for_the_hold_conditions(build_bench, session, plant, doubles):
    class Robbed(doubles.PerfectTarget):
        def handle(self, request):
            if isinstance(request, wire.Settle):
                self.entities.pop("red_cube")
            return super().handle(request)

    profile, cube = build_bench().target.profile, doubles.make_cube()
    bench = build_bench(Robbed(profile, [cube]), library=plant(["wait: {seconds: 0.04}"]))
    session = msgspec.structs.replace(session, hold=("exists(red_cube)",))
    execution = bench.run(session)

    (hold,) = read_bundle(bench.workspace / execution.evidence, session, execution).holds
    assert (execution.ended, hold.truth) == (Ended.COMPLETED, Truth.FALSE)


@pytest.mark.parametrize(("taken", "in_the_way"), [("red_cube", True), ("box", False)])
def test_what_lies_in_a_vessel_is_in_the_way_unless_the_vessel_is_moved(
    build_bench, build_session, doubles, taken, in_the_way
):
    box = doubles.make_cube("box", interior=Interior((0.0, 0.0, 0.05), (0.1, 0.1, 0.1)))
    objects = [box, doubles.make_cube(), doubles.make_cube("blue_cube")]
    planner = doubles.ScriptedPlanner(answer=doubles.refuse)
    bench = build_bench(doubles.PerfectTarget(build_bench().target.profile, objects), planner)
    bench.run(build_session(skill="pick", parameters={"object": taken}))

    names = {entity.name for entity in planner.requests[0].world.entities}
    assert ("blue_cube" in names) == in_the_way
    assert taken in names


def test_a_timeout_of_the_tree_interrupts_and_brakes_before_the_next_leaf(build_bench, session, plant):
    tree = "fallback: {children: [{timeout: {seconds: 0.3, child: move_home}}, {wait: {seconds: 0.1}}]}"
    bench = build_bench(library=plant([tree]))
    bench.target.q = bench.target.q + 0.5
    execution = bench.run(session)

    assert execution.ended is Ended.COMPLETED, execution
    velocities = np.vstack([command.qd_rad_s for command in bench.target.commands()])
    assert np.abs(velocities).max() > 0.1
    assert (np.abs(np.diff(velocities, axis=0)) / 0.002 <= np.array([15, 7.5, 10, 12.5, 15, 20, 20]) * 1.01).all()
    assert not velocities[-1].any()


def test_a_tree_with_problems_ends_before_anything_moves(build_bench, session, plant):
    bench = build_bench(library=plant(["locat"]))
    execution = bench.run(session)

    assert (execution.ended, execution.code) == (Ended.SKILL_FAILED, "BROKEN_TREE")
    assert "UNKNOWN_NAME (leaf): found 'locat'" in execution.message
    assert bench.target.commands() == []
    assert isinstance(bench.target.requests[-1], wire.End)


def test_the_heartbeat_tells_phase_and_active_leaf(build_bench, build_session, doubles):
    bench = build_bench(planner=doubles.ScriptedPlanner(polls=5))
    bench.target.q = bench.target.q + 0.3
    bench.run(build_session(skill="home", parameters={}))

    phases = [beat["phase"] for beat in bench.beats]
    assert list(dict.fromkeys(phases)) == ["loading", "thinking", "executing", "halting", "observing"]
    assert {beat["leaf"] for beat in bench.beats if beat["phase"] == "thinking"} == {"home/move_home"}


def test_the_trace_counts_commands_and_simulated_time_only(build_bench, build_session):
    bench = build_bench()
    bench.target.q = bench.target.q + 0.3
    execution = bench.run(build_session(skill="home", parameters={}))
    lines = (bench.workspace / execution.evidence / evidence.TRACE).read_bytes().splitlines()
    trace = [msgspec.json.decode(line, type=TraceEvent) for line in lines]

    assert [event.tick for event in trace] == sorted(event.tick for event in trace)
    assert trace[-1].tick == execution.ticks
    assert trace[-1].time_s == pytest.approx(0.02 * execution.ticks)


def test_after_a_lost_runner_the_target_is_halted_and_the_world_observed(build_bench, build_session):
    bench = build_bench()
    bench.handle.load(build_session().scene)
    order = Reconcile(session=build_session(), epoch=2, evidence="evidence/x", reason="the worker died", defect="a/b")
    execution = bench.runner.observe_only(order, 2)

    assert (execution.ended, execution.message, execution.ticks) == (Ended.RUNNER_LOST, "the worker died", 0)
    assert (execution.defect, execution.is_final) == ("a/b", True)
    assert (bench.workspace / "evidence" / "x" / evidence.AFTER).exists()
    assert was_halted(bench.target)


def test_the_first_fault_of_a_lost_target_and_what_had_been_commanded_stay_in_the_record(
    build_bench, build_session, doubles
):
    class Failing(doubles.PerfectTarget):
        is_sound = True

        def handle(self, request):
            self.is_sound &= not isinstance(request, wire.Command) or len(self.commands()) < 5
            name = type(request).__name__
            return super().handle(request) if self.is_sound else wire.Refused("PROTOCOL_BROKEN", f"{name}: time = nan")

    target = Failing(build_bench().target.profile)
    bench, session = build_bench(target), build_session(skill="home", parameters={})
    target.q = target.q + 0.3
    lost = bench.run(session)
    target.is_sound = True
    order = Reconcile(session, 2, lost.evidence, lost.message, Ended.TARGET_LOST, lost.code)
    observed = bench.runner.observe_only(order, 2)

    assert (lost.ended, lost.message) == (Ended.TARGET_LOST, "Command: time = nan")
    assert lost.ticks > 0
    assert observed == lost
