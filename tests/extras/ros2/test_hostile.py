"""What a robot does over ROS 2 when it must not: falls silent, dies, measures nonsense, jumps in time, is stopped."""

import threading

import numpy as np
import pytest

from phyagentos.runtime.targets import wire
from phyagentos.testing import DriverSubject
from tests.extras.ros2.cell import CLOCK, CONTROL_PERIOD_S, SCENE, STEP_S

pytestmark = pytest.mark.extras
LIMIT_S = 20.0


@pytest.fixture
def moving(make_cell):
    """A cell whose arm is in the middle of a slow motion, its client, and what is left of the motion."""

    def make(**options):
        cell = make_cell(**options)
        client = (
            DriverSubject(open=cell.reach, scene=SCENE, way=0.4, noise=0.01, set_stop=lambda _: None).serve().begin()
        )
        commands = client.plan()
        for command in commands[:10]:
            assert isinstance(client.send(command), wire.Step)
        return cell, client, commands[10:]

    return make


def send_until_refused(client, commands):
    for command in commands:
        reply = client.send(command)
        if isinstance(reply, wire.Refused):
            return reply
    raise AssertionError("nothing was refused")


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ("silent", "/cell/joint_states: nothing new of 'fr_joint1' within 0.5 s"),
        ("nan 2", "/cell/joint_states: 'fr_joint3' at nan, "),
        ("jump -3.2", "the clock of ROS jumped by -3."),
        ("jump 5.0", "the clock of ROS jumped by +5."),
    ],
)
def test_a_robot_that_is_not_seen_is_lost_comes_to_rest_and_may_come_back(moving, fault, says):
    cell, client, left = moving()
    cell.robot.ask(fault)
    refused = send_until_refused(client, left)

    assert refused.code == "TARGET_LOST"
    assert says in refused.message
    client.ask(wire.End("conformance", 1))
    CLOCK.sleep(1.0)
    truth = cell.robot.ask({"silent": "silent off", "nan 2": "nan"}.get(fault, "truth"))
    assert truth["speed"] < 0.01, "the last message ended at rest"
    assert truth["finite"]
    CLOCK.sleep(0.5)
    assert client.ask(wire.Begin("next", 1)) == wire.Ack()
    assert isinstance(client.ask(client.make(session="next", sequence=1)), wire.Step)


def test_the_wrench_of_the_wrist_is_a_signal_whose_silence_is_a_lost_target(moving):
    cell, client, left = moving(ros2={"wrench": {"topic": "wrist/wrench"}})
    assert "wrench" in client.ask(wire.Describe()).observations
    assert client.ask(wire.Observe()).signals["wrench"] == pytest.approx((1.0, -2.0, 9.5, 0.1, 0.0, -0.3))
    cell.robot.ask("numb")
    refused = send_until_refused(client, left)
    assert (refused.code, refused.message) == ("TARGET_LOST", "/cell/wrist/wrench: nothing new within 0.5 s")


def test_a_clock_that_jumps_between_sessions_ends_none(make_cell):
    cell = make_cell()
    client = DriverSubject(open=cell.reach, scene=SCENE, noise=0.01, set_stop=lambda _: None).serve()
    client.load()
    before_s = client.ask(wire.Observe()).time_s
    cell.robot.ask("jump -30.0")
    CLOCK.sleep(1.0)
    assert before_s <= client.begin().ask(wire.Observe()).time_s < before_s + 20.0
    assert isinstance(client.send(client.make()), wire.Step)


def test_a_robot_that_is_gone_is_lost_and_the_kit_stays(moving):
    cell, client, left = moving()
    cell.robot.kill()
    refused = send_until_refused(client, left)

    assert refused.code == "TARGET_LOST"
    client.target.withdraw()
    assert client.ask(wire.Observe()).code == "TARGET_LOST"
    assert client.ask(wire.Describe()).driver == "ros2"


def test_an_emergency_stop_reaches_the_robot_within_two_periods(moving):
    latencies = []
    for _ in range(3):
        cell, client, left = moving()
        command = client.make(q_rad=left[0].q_rad, qd_rad_s=left[0].qd_rad_s)
        thread = threading.Thread(target=client.ask, args=(command,))
        thread.start()
        set_s = cell.robot.ask("truth")["time_s"]
        cell.set_stop(True)
        thread.join()
        client.ask(wire.Observe())
        truth = cell.robot.ask("truth")
        latencies.append((truth["stopped_at_s"] - set_s) / CONTROL_PERIOD_S)
        assert truth["stops"] == 1
        assert client.send(client.make()).code == "ESTOPPED"
        CLOCK.sleep(0.5)
        assert cell.robot.ask("truth")["speed"] < 0.01
    print(f"\nstop in motion: {', '.join(f'{each:.2f}' for each in latencies)} periods of {CONTROL_PERIOD_S} s")  # noqa: T201
    assert sorted(latencies)[1] <= 2.0, "the middle one: a machine that does other work is late at times"


def test_a_client_that_is_gone_leaves_the_robot_at_rest_where_it_braked(moving):
    cell, client, _left = moving()
    client.target.withdraw()
    truth = cell.robot.ask("truth")

    assert truth["speed"] < 0.02
    assert set(truth["counts"]) <= {"taken", "in the past"}


def test_latency_and_loss_of_set_points_are_figures_of_the_robot(moving):
    cell, client, left = moving()
    for command in left:
        assert isinstance(client.send(command), wire.Step)
    truth = cell.robot.ask("truth")
    counts, late = truth["counts"], truth["late_ms"]
    dropped = counts.get("in the past", 0)
    print(  # noqa: T201
        f"\n{truth['messages']} set-points, one each {1e3 * STEP_S:.0f} ms, when taken {late[0]:.1f}, {late[1]:.1f},"
        f" {late[2]:.1f} ms old (median, 95 %, most), {dropped} dropped, at {truth['factor']:.2f} of real time"
    )
    assert counts["taken"] > 0.9 * truth["messages"]
    now = client.ask(wire.Settle("conformance", 1, 0.5))
    assert np.abs(np.array(now.target.q_rad) - left[-1].q_rad[-1]).max() < 0.02


def test_what_is_not_there_is_said_before_anything_moves(make_cell):
    cell = make_cell(kind="trajectory")
    path = cell.project / "robots" / "panda" / "ros2.yaml"
    text = path.read_text()
    for old, new, says in (
        ("arm_controller/joint_trajectory", "other/joint_trajectory", "found nothing at /cell/other/joint_trajectory"),
        ("name: fr_joint4", "name: joint4", "/cell/joint_states: no joint 'joint4'; it has fr_joint1, fr_joint2"),
        ("service: stop", "service: halt", "found nothing at /cell/halt"),
    ):
        path.write_text(text.replace(old, new).replace("use_sim_time", "wait_s: 3.0\nuse_sim_time"))
        assert says in cell.serve()
        body = cell.bodies.pop()
        assert body.close() == 2
        assert "Traceback" not in (cell.folder / "body.log").read_text()
