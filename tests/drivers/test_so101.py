"""The driver of the SO-101, before servos that are emulated packet by packet and an arm in MuJoCo."""

import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.operations.why import why
from phyagentos.protocol.sessions.estop import Latch, latch
from phyagentos.runtime.drivers.devices.specs import SO101
from phyagentos.testing import DRIVER_CHECKS, DriverSubject
from tests.drivers.journeys import Journey
from tests.drivers.sts3215 import SYNC_WRITE, TORQUE

pytestmark = [pytest.mark.device, pytest.mark.alone]

ACCELERATION = 41
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
POSTURE = (0.0, -1.2, 1.2, 0.6, 0.0, 0.5)


@pytest.fixture
def arm(menagerie, need_package):
    need_package("scservo_sdk")
    from tests.drivers.sts3215 import So101

    arm = So101(menagerie / "robotstudio_so101" / "scene.xml", JOINTS, POSTURE)
    yield arm
    arm.close()


@pytest.fixture
def subject(arm, menagerie, make_site):
    site = make_site("so101", menagerie / "robotstudio_so101", endpoint=arm.port)
    subject = DriverSubject(open=lambda: SO101.open(site), scene="cell", noise=0.005)
    yield subject
    subject.close()


@pytest.mark.parametrize("check", DRIVER_CHECKS, ids=lambda check: check.__name__)
def test_the_driver_does_what_the_port_promises(subject, check):
    check(subject)


@pytest.fixture
def journey(arm, menagerie, make_site, tmp_path):
    site = make_site("so101", menagerie / "robotstudio_so101", endpoint=arm.port, control_period_s=0.1)
    journey = Journey(site.workspace, "so101", tmp_path)
    yield journey
    journey.close()


@pytest.mark.journey
def test_a_goal_is_carried_out_by_the_servos(arm, journey):
    report = journey.begin().finish()

    assert report.verdict == "success", report
    assert len(find_frames(arm, ACCELERATION)) >= 200


@pytest.mark.journey
def test_an_emergency_stop_is_a_frame_on_the_bus_and_the_servos_stand(arm, journey):
    journey.begin()
    stops = len(find_frames(arm, TORQUE))
    latch(journey.workspace.signals.parent, Latch(by="test", reason="a hand in the cell"))
    report = journey.finish()

    assert [(each.ended, each.code) for each in report.sessions] == [("safety_stop", "ESTOPPED")]
    assert journey.count("EStop") == 1
    assert len(find_frames(arm, TORQUE)) == stops + 1
    assert arm.goals() == pytest.approx(arm.present(), abs=4)
    count = len(arm.frames)
    SystemClock().sleep(0.5)
    assert not [frame for frame in arm.frames[count:] if frame[0] == SYNC_WRITE]


@pytest.mark.journey
def test_a_cut_cable_ends_the_session_as_a_lost_target_that_names_the_port(arm, journey):
    journey.begin()
    arm.cut()
    (session,) = journey.finish().sessions

    assert (session.ended, session.code) == ("target_lost", "TARGET_LOST")
    told = "\n".join(why(journey.workspace.root, session.id).explanation)
    assert f"TARGET_LOST: the target refused Halt: {arm.port}: a servo: [TxRxResult] There is no status packet!" in told


def test_a_servo_that_complains_stops_the_arm(arm, subject):
    client = subject.serve().begin()
    commands = client.plan()
    client.send(commands[0])
    arm.fail(2, 32)
    step = client.send(commands[1])

    assert step.stopped == "PROTECTIVE_STOP"
    assert not client.target.is_moving
    assert client.send(commands[2]).code == "PROTECTIVE_STOP"


def test_a_port_that_is_not_there_is_refused_by_its_name(menagerie, need_package, make_site):
    need_package("scservo_sdk")
    site = make_site("so101", menagerie / "robotstudio_so101", endpoint="/dev/nothing")

    with pytest.raises(ExecutionError, match=r"TARGET_LOST: /dev/nothing: .*No such file.*; check cable and power"):
        SO101.open(site)


def find_frames(arm, address):
    """Goals of all servos: from the register of the torque on (a stop), or without it."""
    return [told for kind, _, told in list(arm.frames) if kind == SYNC_WRITE and told[0] == address]
