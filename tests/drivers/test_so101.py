"""The driver of the SO-101, before servos that are emulated packet by packet and an arm in MuJoCo."""

from dataclasses import replace

import mujoco
import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.operations.calibrate import write_settings
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.runtime.drivers.devices.specs import SO101
from phyagentos.testing import DRIVER_CHECKS, DriverSubject
from tests.drivers.journeys import Journey
from tests.drivers.sts3215 import OFFSET, SYNC_WRITE, TORQUE

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
    journey.stop()

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

    assert f"TARGET_LOST: {arm.port}: a servo: [TxRxResult] There is no status packet!" in journey.explain_loss()


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


WAYS = {
    "shoulder_pan": (-1.92, 1.92),
    "shoulder_lift": (-1.74, 1.74),
    "elbow_flex": (-1.69, 1.69),
    "wrist_flex": (-1.65, 1.65),
    "wrist_roll": (-2.0, 2.0),
}  # fmt: skip - the roll has no stops where the model has


class Person:
    """Does at the emulated arm what is requested, up to `slack_rad`."""

    def __init__(self, arm, home_rad, slack_rad=0.0):
        self.arm, self.home, self.slack_rad, self.heard = arm, home_rad, slack_rad, []

    def __call__(self, request):
        self.heard.append(request)
        posture = [*self.home, 0.0]
        if "posture" in request:
            posture = [each + self.slack_rad for each in self.home] + [-0.15]
        elif "jaw" in request:
            posture[-1] = 1.7
        for index, (name, ends) in enumerate(WAYS.items()):
            if f"Turn {name} " in request:
                posture[index] = ends["upper" in request]
        self.arm.plant.place(posture)


@pytest.fixture
def calibrate(arm, menagerie, make_site):
    """What is written for an arm whose servo 2 keeps an offset."""
    site = make_site("so101", menagerie / "robotstudio_so101", endpoint=arm.port)
    arm.put(1, OFFSET, 100)
    arm.plant.model.opt.gravity[:] = 0.0  # the person holds it, at its stops as the model has them
    arm.plant.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT

    def calibrate(slack_rad=0.0):
        person = Person(arm, site.profile.arm.home_rad, slack_rad)
        found = SO101.calibrate(site.profile, site.folder, site.clock, person)
        assert len(person.heard) == 3 + 2 * len(WAYS)
        return found

    calibrate.site = site
    return calibrate


def test_calibration_finds_zeros_by_the_stops_and_what_has_none_by_the_picture(calibrate):
    found = calibrate(slack_rad=0.05)
    roll = 2048 + round(0.05 * 4096 / 6.2832)
    assert found["zero_steps"] == pytest.approx([2048, 1948, 2048, 2048, roll], abs=8)
    assert found["directions"] == [1, 1, 1, 1, 1]
    assert found["q_max_rad"] == pytest.approx([1.88, 1.7, 1.65, 1.61, 1.91], abs=0.02)
    assert found["offsets"] == [0, 100, 0, 0, 0, 0]
    assert found["jaw_open_steps"] - found["jaw_closed_steps"] == pytest.approx(1.85 * 4096 / 6.2832, abs=8)


def test_an_arm_that_stood_elsewhere_than_in_the_picture_is_refused_joint_by_joint(calibrate):
    with pytest.raises(DefinitionError, match=r"INVALID_VALUE: found 0\.50 rad between its posture") as error:
        calibrate(slack_rad=0.5)
    assert [each.address for each in error.value.problems] == [f"so101: {name}" for name in list(WAYS)[:4]]


def test_a_calibration_is_written_into_the_profile_and_refused_once_a_servo_counts_from_elsewhere(arm, calibrate):
    site = calibrate.site
    path = site.folder / "target.yaml"
    path.write_text(write_settings(path.read_text(), calibrate()))
    changed = replace(site, profile=read_target(path))
    assert "# data sheet STS3215-C018" in path.read_text(), "comments stay"
    SO101.open(changed).close()
    arm.put(3, OFFSET, 7)
    said = r"CHANGED: found \[0, 100, 0, 7, 0, 0\]; expected \[0, 100, 0, 0, 0, 0\], as calibrated at 20"
    with pytest.raises(DefinitionError, match=said):
        SO101.open(changed)
