"""The driver of the Go2, before a robot on DDS in another process, and a third participant that listens."""

import itertools
import struct

import msgspec
import numpy as np
import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.runtime.drivers.devices.go2_bus import compute_crc, define_messages
from phyagentos.runtime.drivers.devices.specs import GO2
from phyagentos.runtime.targets.wire import Ack, Begin, End, Loaded, LoadScene, Settle
from phyagentos.testing import DRIVER_CHECKS, DriverSubject
from phyagentos.testing.driver_checks import EPOCH, SESSION
from tests.drivers.journeys import Journey

pytestmark = [pytest.mark.device, pytest.mark.alone]

STANDING = (0.0, 0.9, -1.8) * 4
WEIGHT_RAD = 0.03  # kp of 60 gives way to a bent leg in the air by 0.018


@pytest.fixture(scope="module")
def robot_process(menagerie, need_package):
    need_package("cyclonedds")
    from tests.drivers.go2 import Go2

    robot = Go2(menagerie / "unitree_go2" / "scene.xml")
    yield robot
    robot.close()


@pytest.fixture
def robot(robot_process):
    robot_process.ask("rest")
    return robot_process


@pytest.fixture
def open_site(menagerie, make_site):
    def make(**changes):
        told = {"endpoint": "lo", "domain": 1, "peer": "localhost"} | changes
        return make_site("go2", menagerie / "unitree_go2", **told)

    return make


@pytest.fixture
def subject(robot, open_site):
    site = open_site()
    subject = DriverSubject(open=lambda: GO2.open(site), scene="cell", noise=0.005)
    yield subject
    subject.close()


@pytest.mark.parametrize("check", DRIVER_CHECKS, ids=lambda check: check.__name__)
def test_the_driver_does_what_the_port_promises(subject, check):
    check(subject)


def test_twelve_joints_go_from_hanging_to_a_posture(subject, robot):
    client = subject.serve().begin()
    first, rows = client.make(), np.arange(1, 201)[:, None] / 200.0
    start = first.q_rad[0]
    q = start + (np.array(STANDING) - start) * (3.0 * rows**2 - 2.0 * rows**3)
    qd = (np.array(STANDING) - start) * (6.0 * rows - 6.0 * rows**2) / 2.0
    for period in range(100):
        part = slice(2 * period, 2 * period + 2)
        client.send(msgspec.structs.replace(first, sequence=period + 1, q_rad=q[part], qd_rad_s=qd[part]))
    step = client.ask(Settle(SESSION, EPOCH, 0.5))
    reached, speeds, wrong, _ = robot.ask("look")

    assert client.sequence == 100
    assert reached == pytest.approx(STANDING, abs=WEIGHT_RAD)
    assert step.target.q_rad == pytest.approx(reached, abs=0.005)
    assert np.abs(reached - start).max() > 0.3
    assert np.abs(speeds).max() < 0.02
    assert wrong == 0


def test_while_the_sport_mode_commands_a_session_is_stopped_and_none_begins(subject, robot):
    client = subject.serve().begin()
    commands = client.plan()
    client.send(commands[0])
    robot.ask("sport")
    SystemClock().sleep(0.1)
    step = client.send(commands[1])

    assert step.stopped == "PROTECTIVE_STOP"
    client.ask(End(SESSION, EPOCH))
    refused = client.ask(Begin("next", EPOCH))
    assert refused.code == "BUSY"
    assert refused.message.startswith(
        "lo: another program commands the legs on rt/lowcmd; release the sport mode first"
    )
    robot.ask("rest")
    assert isinstance(client.ask(Begin("next", EPOCH + 1)), Ack)


def test_the_network_is_the_profiles_whatever_the_users_environment_says(subject, monkeypatch):
    interface = '<General><Interfaces><NetworkInterface name="nodds0"/></Interfaces></General>'
    monkeypatch.setenv("CYCLONEDDS_URI", f"<CycloneDDS><Domain>{interface}</Domain></CycloneDDS>")
    assert isinstance(subject.serve().load(), Loaded)


@pytest.fixture
def journey(robot, open_site, tmp_path):
    journey = Journey(open_site(control_period_s=0.1, physics_step_s=0.02).workspace, "go2", tmp_path)
    yield journey
    journey.close()


@pytest.fixture
def listener(robot):
    from tests.drivers.go2 import Listener

    listener = Listener()
    yield listener
    listener.close()


@pytest.mark.journey
def test_a_goal_is_carried_out_by_the_legs(robot, journey):
    report = journey.begin().finish()

    assert report.verdict == "success", report
    _, _, wrong, swing = robot.ask("look")
    assert wrong == 0
    assert swing == pytest.approx(0.15, abs=0.03)


@pytest.mark.journey
def test_an_emergency_stop_is_a_frame_that_a_third_participant_sees(robot, listener, journey):
    journey.begin()
    assert listener.count(is_stop=False) >= 50
    assert listener.count(is_stop=True) == 0
    journey.stop()

    assert listener.count(is_stop=True) >= 1
    commands, first = listener.count(is_stop=False), listener.frames.index(True)
    SystemClock().sleep(0.5)
    assert listener.count(is_stop=False) == commands == first
    assert np.abs(robot.ask("look")[1]).max() < 0.05


@pytest.mark.journey
def test_a_cut_bus_ends_the_session_as_a_lost_target_that_names_the_network(robot, journey):
    journey.begin()
    robot.ask("cut")

    assert "lo: no LowState within 0.2 s; check cable, power and interface" in journey.explain_loss()


def test_an_interface_that_is_not_there_is_named(menagerie, need_package, open_site):
    need_package("cyclonedds")
    with pytest.raises(ExecutionError, match=r"TARGET_LOST: nodds0, domain 1: .*; check cable and interface"):
        GO2.open(open_site(endpoint="nodds0"))


def test_a_robot_that_is_not_there_is_lost_when_it_is_asked(menagerie, need_package, open_site):
    need_package("cyclonedds")
    driver = GO2.open(open_site(domain=2))
    with pytest.raises(ExecutionError, match=r"TARGET_LOST: lo: no LowState within 0.2 s"):
        driver.load(LoadScene("cell", 1, "e"))
    driver.close()


@pytest.mark.parametrize("name", ["LOW_CMD", "LOW_STATE"])
def test_a_message_has_the_fields_of_the_vendors_struct_in_its_order(need_package, name):
    need_package("cyclonedds")
    from tests.drivers import go2

    _, command, state = define_messages()
    kind = {"LOW_CMD": command, "LOW_STATE": state}[name]
    letters, at, leaves = go2.list_letters(getattr(go2, name)), 0, []
    message = go2.number_leaves(kind(), itertools.cycle(range(1, 128)))
    data = message.serialize()[4:]
    for letter in letters:
        at = -(-at // struct.calcsize(letter)) * struct.calcsize(letter)  # CDR aligns each number, and no struct
        leaves += struct.unpack_from(f"<{letter}", data, at)
        at += struct.calcsize(letter)

    assert at == len(data)
    assert leaves == go2.list_leaves(message)
    assert len(set(leaves)) > 100


def test_the_checksum_is_the_vendors(need_package):
    need_package("cyclonedds")
    from tests.drivers import go2

    LowCmd = define_messages().command
    for message in (LowCmd(), go2.number_leaves(LowCmd(), itertools.cycle(range(1, 128)))):
        assert compute_crc(message) == go2.compute_checksum(message)
    assert compute_crc(LowCmd()) != compute_crc(LowCmd(level_flag=0xFF))
