"""The driver of the SO-101, before servos that are emulated packet by packet and an arm in MuJoCo."""

import pytest

from phyagentos.cli.why import explain_session
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.estop import Latch, latch, reset
from phyagentos.runtime.drivers.devices.specs import SO101
from phyagentos.runtime.targets.conformance import CHECKS, Subject
from tests.drivers.journeys import Journey
from tests.drivers.sts3215 import SYNC_WRITE
from tests.following import wait_until

pytestmark = [pytest.mark.device, pytest.mark.alone]

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
    subject = Subject(open=lambda: SO101.open(site), scene="cell", noise=0.005)
    yield subject
    subject.close()


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
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
    goals = [frame[2] for frame in arm.frames if frame[0] == SYNC_WRITE and frame[2][0] == 41]
    assert len(goals) >= 200


@pytest.mark.journey
def test_an_emergency_stop_is_a_frame_on_the_bus_and_the_servos_stand(arm, journey):
    journey.begin()
    latch(journey.workspace.signals.parent, Latch(by="test", reason="a hand in the cell"))
    wait_until(lambda: journey.count("EStop") == 1, "the stop")

    last = [frame for frame in arm.frames if frame[0] == SYNC_WRITE][-1]
    assert [each for each in last[2][2::8]] == [1, 2, 3, 4, 5, 6]
    assert arm.goals() == pytest.approx(arm.present(), abs=4)
    begun = len([frame for frame in arm.frames if frame[0] == SYNC_WRITE])
    SystemClock().sleep(0.5)
    assert len([frame for frame in arm.frames if frame[0] == SYNC_WRITE]) == begun
    (status,) = journey.mission.ledger.sessions.values()
    print(status)
    reset(journey.workspace.signals.parent, "the hand is gone", SystemClock())
    report = journey.finish()
    print(report)


@pytest.mark.journey
def test_a_cut_cable_ends_the_session_as_a_lost_target_that_names_the_port(arm, journey):
    journey.begin()
    arm.cut()
    report = journey.finish()
    print(report)
    for id in journey.mission.ledger.sessions:
        print(explain_session(journey.workspace, journey.mission.ledger, id))
    assert 0
