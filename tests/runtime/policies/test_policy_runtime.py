"""A policy as a skill: its chunks are carried out, refused or given up, and the session ends for the right reason."""

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.action_spaces import ActionSpace, GripperRange
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.sessions.evidence import read_bundle
from phyagentos.protocol.sessions.session import Ended, Limits
from phyagentos.protocol.settings.sensors import Sensors, read_sensors
from phyagentos.protocol.world.faults import FaultFile
from phyagentos.runtime.actions.bridges.chain import BridgeChain
from phyagentos.runtime.actions.chunks import iter_periods
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector, draw_schedule
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.policies.policy_runtime import Policies
from phyagentos.runtime.policies.policy_server import serve_policy
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from tests.policies import STREAM, describe, serve

CAMERA = {
    "camera_rgb": {"modality": "rgb", "frame": "overhead", "shape": [144, 192, 3], "dtype": "uint8", "rate_hz": 25}
}
NO_CAMERA, NO_SENSORS = {}, Sensors(sensors={})


class Line:
    """Moves joint 4 by a smooth `way_rad` over `rows` rows; whatever `spoil` does to a chunk comes on top."""

    def __init__(self, home, way_rad=-0.3, rows=80, chunk=25, spoil=lambda rows, sequence: rows):
        s = np.linspace(0.0, 1.0, rows + 1)[1:, None]
        smooth = 10 * s**3 - 15 * s**4 + 6 * s**5
        self.rows = np.hstack((home + smooth * way_rad * np.eye(7)[3], np.full((rows, 1), 0.08)))
        self.chunk, self.spoil = chunk, spoil
        self.shown = []

    def start(self, request):
        self.shown.clear()

    def infer(self, request):
        self.shown.append(request.observations["joint_state"])
        chunk = self.rows[request.rows_done : request.rows_done + self.chunk]
        return self.spoil(chunk, request.sequence), request.rows_done + len(chunk) >= len(self.rows)


@pytest.fixture
def build_target(doubles, profile):
    return lambda: doubles.PerfectTarget(profile, [doubles.make_cube()])


@pytest.fixture
def run_policy(build_bench, build_session, doubles, profile):
    def run(policy, target=None, sensors=NO_SENSORS, streams=NO_CAMERA, parameters=NO_CAMERA, how=NO_CAMERA, **limits):
        descriptor = describe(policy="line/1", observations={"joint_state": STREAM} | streams, execution=how)
        endpoint = serve(serve_policy, policy, descriptor)
        skill = SkillRuntime(
            skill="line",
            description="Moves one joint.",
            kind="policy",
            tree="",
            action_space=ActionSpace(
                representation="joint_position",
                joints=profile.arm.joints,
                rate_hz=50,
                chunk_length=25,
                gripper=GripperRange(closed=0.0, open=0.08),
            ),
            policy=descriptor.model_copy(update={"endpoint": endpoint}),
        )
        serving = {"skills": {"line": skill}, "profile": profile, "sensors": sensors, "late_max_s": 0.3}
        bench = build_bench(
            target=target,
            policies=lambda handle: Policies(handle=handle, is_realtime=False, **serving),
            clock=SystemClock(),
        )
        session = build_session(skill="line", parameters=parameters, limits=Limits(**limits))
        execution = bench.run(session, policy="policy_adapter://line/1")
        trace = read_bundle(bench.workspace / execution.evidence, session, execution).trace
        return bench, execution, trace

    return run


def test_a_policy_is_asked_until_it_says_that_it_is_done(run_policy, profile):
    policy = Line(np.asarray(profile.arm.home_rad))
    bench, execution, trace = run_policy(policy)
    assert execution.ended is Ended.COMPLETED, execution
    assert execution.ticks == len(bench.target.commands()) == 80
    assert bench.target.q == pytest.approx(policy.rows[-1, :7])
    assert [event.status for event in trace] == ["RUNNING"] * len(policy.shown) + ["SUCCESS"]
    assert policy.shown[1][3] == pytest.approx(policy.rows[20, 3]), "it saw where its first chunk had led"


WORLD = {"modality": "simulator_state", "shape": [1, 7], "dtype": "float64", "rate_hz": 50, "entities": ["object"]}


@pytest.mark.parametrize("aim", [{}, {"aim": [0.02, -0.01, 0.0]}])
def test_an_object_is_shown_aside_by_the_aim_and_missed_by_where_it_is_believed(run_policy, profile, aim):
    policy, seen = Line(np.asarray(profile.arm.home_rad)), []
    look, policy.infer = policy.infer, lambda request: (seen.append(request.observations), look(request))[1]
    parameters = {"object": "red_cube"} | aim
    bench, execution, _ = run_policy(
        policy, streams={"environment_state": WORLD}, parameters=parameters, how={"aim": "aim"}
    )
    assert execution.ended is Ended.COMPLETED, execution
    believed = np.array(bench.target.entities["red_cube"].pose.position_m)
    (shown,) = seen[0]["environment_state"]
    assert shown[:3] == pytest.approx(believed + aim.get("aim", (0.0, 0.0, 0.0)))
    tool = bench.target.handle(wire.Observe()).target.tcp.position_m
    assert execution.outputs["missed_m"] == pytest.approx(believed - tool, abs=1e-4)


def test_a_policy_that_is_shown_no_object_has_missed_none(run_policy, profile):
    _, execution, _ = run_policy(Line(np.asarray(profile.arm.home_rad)))
    assert execution.outputs.keys() == {"chunks", "control_periods"}


def test_the_same_policy_twice_gives_the_same_commands_bit_for_bit(run_policy, profile):
    commands = [
        np.vstack([each.q_rad for each in run_policy(Line(np.asarray(profile.arm.home_rad)))[0].target.commands()])
        for _ in range(2)
    ]
    assert np.array_equal(*commands)


@pytest.mark.parametrize(
    ("spoil", "ended", "code"),
    [
        (lambda rows, _: rows[:, :7], Ended.SKILL_FAILED, "WRONG_SHAPE"),
        (lambda rows, _: np.vstack([rows] * 3), Ended.SKILL_FAILED, "WRONG_SHAPE"),
        (lambda rows, _: rows * np.nan, Ended.SKILL_FAILED, "NOT_FINITE"),
        (lambda rows, _: rows + 1e6, Ended.SKILL_FAILED, "DISCONTINUOUS"),
        (lambda rows, _: rows + 0.02 * (np.arange(len(rows)) % 2)[:, None], Ended.SAFETY_STOP, "JOINT_ACCELERATION"),
        (lambda rows, _: 1 / 0, Ended.SKILL_FAILED, "POLICY_FAILED"),
    ],
    ids=["narrow", "long", "nan", "far", "jerky", "raising"],
)
def test_a_chunk_that_must_not_be_carried_out_is_not(run_policy, profile, spoil, ended, code):
    later = lambda rows, sequence: spoil(rows, sequence) if sequence else rows  # noqa: E731
    bench, execution, _ = run_policy(Line(np.asarray(profile.arm.home_rad), spoil=later))
    assert execution.ended is ended, execution
    assert execution.code == code
    assert len(bench.target.commands()) <= 21, "the first chunk was sound, and no command of the second was given"


@pytest.mark.parametrize(
    ("spoil", "found", "lines"),
    [
        (lambda rows: rows[None], "found (1, 25, 8); expected (25, 8): 25 rows at most", "`batch: true`"),
        (lambda rows: np.pad(rows, ((0, 0), (0, 24))), "found (25, 32); expected (25, 8)", "`padding: 24`"),
        (lambda rows: np.vstack([rows] + [rows[-1:]] * 25), "found (50, 8)", "`chunk_length: 50`"),
        (lambda rows: rows[:, :7], "expected (25, 8): 25 rows at most, each of 7 joints and a gripper", ""),
        (lambda rows: rows[:0], "found (0, 8)", ""),
        (lambda rows: np.hstack((np.degrees(rows[:, :7]), rows[:, 7:])), "joint", "`angle_unit: deg`"),
        (lambda rows: rows - np.vstack((rows[:1, :7], rows[:-1, :7])) @ np.eye(7, 8), "joint", "`delta: true`"),
        (lambda rows: rows @ np.diag([*[1] * 7, 12.5]), "closed is 0, open 0.08", "`gripper: {closed: 0, open: 1}`"),
        (lambda rows: rows @ np.diag([*[1] * 7, -12.5]), "found -1; closed is 0", "`gripper: {closed: -1, open: 1}`"),
        (lambda rows: rows * [*[1] * 7, np.nan], "gripper, row 0: found nan, which is no finite number", ""),
    ],
)  # fmt: skip
def test_a_chunk_of_another_form_is_told_with_the_lines_of_the_contract_that_mend_it(
    run_policy, profile, spoil, found, lines
):
    _, execution, _ = run_policy(Line(np.asarray(profile.arm.home_rad), spoil=lambda rows, _: spoil(rows)))
    assert execution.ticks == 0
    assert found in execution.message, execution
    assert (f"It would be carried out with {lines} in action_space" in execution.message) is bool(lines), execution


def test_an_error_of_the_policys_own_code_is_a_defect_of_its_file_and_line(run_policy, profile):
    look = lambda rows, _: rows["wrist"]  # noqa: E731
    _, execution, _ = run_policy(Line(np.asarray(profile.arm.home_rad), spoil=look))
    assert (execution.code, execution.defect) == ("POLICY_FAILED", f"{__file__}:{look.__code__.co_firstlineno}")
    assert execution.defect in execution.message


def test_an_error_of_a_bridge_of_a_package_is_a_defect_and_ends_no_worker(run_policy, profile, monkeypatch):
    def apply(*_):
        raise KeyError("joint9")

    monkeypatch.setattr(BridgeChain, "apply", apply)
    _, execution, _ = run_policy(Line(np.asarray(profile.arm.home_rad)))
    place = f"{__file__}:{apply.__code__.co_firstlineno + 1}"
    assert (execution.code, execution.defect, execution.leaf) == ("LEAF_ERROR", place, "policy")
    assert execution.message == f"KeyError: 'joint9' ({place})"


def test_a_policy_that_hangs_ends_the_session_by_name(run_policy, profile):
    never = threading.Event()
    hang = lambda rows, sequence: never.wait(20) if sequence else rows  # noqa: E731
    _, execution, _ = run_policy(Line(np.asarray(profile.arm.home_rad), spoil=hang), policy_s=0.1)
    never.set()
    assert (execution.ended, execution.code, execution.leaf) == (Ended.SKILL_FAILED, "POLICY_LOST", "policy")
    assert "sent nothing for 0.1 s" in execution.message


def test_an_arm_that_does_not_follow_is_not_driven_on(run_policy, build_target, profile):
    target = build_target()
    target.stuck_joint = 3
    policy = Line(np.asarray(profile.arm.home_rad), way_rad=0.8)
    _, execution, _ = run_policy(policy, target)
    assert (execution.ended, execution.code, execution.leaf) == (Ended.STALLED, "STALLED", "policy"), execution
    assert "rad behind its set-points" in execution.message


def test_a_chunk_whose_whole_time_has_passed_when_it_comes_is_not_carried_out(run_policy, build_target, profile):
    target = build_target()

    def dawdle(rows, sequence):
        target.time_s += 0.0 if sequence else 3.0
        return rows

    policy = Line(np.asarray(profile.arm.home_rad), rows=25, spoil=dawdle)
    _, execution, trace = run_policy(policy, target)
    assert execution.ended is Ended.COMPLETED, execution
    assert [event.numbers.get("rows") for event in trace] == [0, 25, None], "it was asked again, and shown the present"
    assert execution.ticks == 25


def test_a_chunk_shorter_than_the_declared_inference_is_carried_out_when_it_comes_within_it(
    run_policy, build_target, profile
):
    target = build_target()

    def think(rows, _):
        target.time_s += 0.09
        return rows

    _, execution, _ = run_policy(Line(np.asarray(profile.arm.home_rad), way_rad=0.0, rows=1, spoil=think), target)
    assert (execution.ended, execution.ticks) == (Ended.COMPLETED, 1), execution


@pytest.fixture
def watch(run_policy, library, profile):
    """A policy that is shown a camera of a simulated world, which a fault of it strikes after 0.5 s."""

    def run(policy, **fault):
        when = {"session": "*", "time_s": 0.5}
        faults = [{"camera": "overhead", "when": when} | fault] if fault else []
        file = FaultFile.model_validate({"version": 1, "faults": faults})
        sensors = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")
        shared = SimulatedWorld(
            library, faults=lambda *episode: FaultInjector(draw_schedule(file, *episode)), sensors=sensors
        )
        driver = MujocoDriver(shared, profile, library.get_target("panda").parent)
        world = ServedTarget(driver, ReceiveLog(None))
        return run_policy(policy, world, sensors, CAMERA)[1]

    return run


@pytest.mark.sim
@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ({"kind": "freeze", "stamp": "fresh"}, "frozen: a new stamp, and its own count of exposures stands"),
        ({"kind": "blackout", "mode": "dark"}, "dark: no depth at all"),
    ],
    ids=["frozen", "dark"],
)
def test_a_policy_is_not_driven_by_a_camera_that_does_not_show_the_present(watch, profile, fault, why):
    policy = Line(np.asarray(profile.arm.home_rad))
    execution = watch(policy, **fault)
    assert (execution.ended, execution.code) == (Ended.SKILL_FAILED, "OBSERVATION_UNAVAILABLE"), execution
    assert execution.leaf == "policy"
    assert f"camera 'overhead' is {why}" in execution.message
    assert len(policy.shown) <= 3, "a second picture tells at the latest"


@pytest.mark.sim
def test_a_policy_whose_camera_does_well_comes_to_its_end(watch, profile):
    assert watch(Line(np.asarray(profile.arm.home_rad))).ended is Ended.COMPLETED


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), k=st.integers(1, 30))
def test_a_chunk_passes_through_its_rows_and_leaves_without_a_jump(seed, k):
    rng = np.random.default_rng(seed)
    before, velocity = rng.normal(size=8), rng.normal(size=7)
    rows = before + np.cumsum(rng.normal(scale=0.02, size=(k, 8)), axis=0)
    periods = list(iter_periods(rows, before, velocity, n_steps=10, step_s=0.002))
    assert len(periods) == k
    ends = np.vstack([np.append(each.q_rad[-1], each.gripper_width_m[-1]) for each in periods])
    assert ends == pytest.approx(rows)
    q = np.vstack([each.q_rad for each in periods])
    qd = np.vstack([each.qd_rad_s for each in periods])
    steps = np.diff(q, axis=0, prepend=before[None, :7]) / 0.002
    means = (np.vstack((velocity, qd))[1:] + np.vstack((velocity, qd))[:-1]) / 2
    fastest = 1e-3 + 0.05 * np.abs(np.vstack((velocity, qd))).max()
    assert np.abs(steps - means).max() <= fastest, "velocity rows are the velocity of the position rows"
