"""The driver of the PIPER, before an arm that is emulated frame by frame, and a third node that listens."""

import itertools
import threading

import pytest

from phyagentos.assembly.paths import TOKENS
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.runtime.drivers.devices.specs import PIPER
from phyagentos.runtime.targets.handshake import Tokens, make_key
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import serve_realtime
from phyagentos.runtime.targets.stop_listener import StopListener
from phyagentos.runtime.targets.websocket import WebSocketDoor, connect_websocket
from phyagentos.runtime.targets.wire import LoadScene
from phyagentos.testing import DRIVER_CHECKS, DriverSubject, ReachedTarget
from tests.drivers.journeys import Journey
from tests.following import wait_until

pytestmark = [
    pytest.mark.device,
    pytest.mark.alone,
    pytest.mark.filterwarnings("ignore:The 'bustype' argument is deprecated:DeprecationWarning"),  # piper_sdk uses it
]

POSTURE = (0.0, 1.57, -1.3485, 0.0, 0.3, 0.0)
LYING = (0.0, 0.3, -0.03, 0.0, 0.73, 0.0)  # where it comes to rest on the table without power
CHANNELS = (f"piper{number}" for number in itertools.count())  # the package keeps one interface per name


@pytest.fixture
def make_arm(menagerie, need_package):
    need_package("piper_sdk")
    from tests.drivers.piper import Listener, Piper

    made = []

    def make(q_rad=POSTURE, powered=True):
        channel = next(CHANNELS)
        arm = Piper(menagerie / "agilex_piper" / "scene.xml", channel, q_rad, powered)
        arm.channel, arm.bus = channel, Listener(channel)
        made.extend((arm.bus, arm))
        return arm

    yield make
    for each in made:
        each.close()


@pytest.fixture
def open_site(menagerie, make_site):
    def make(arm, **changes):
        told = {"endpoint": arm.channel, "interface": "virtual"} | changes
        return make_site("piper", menagerie / "agilex_piper", **told)

    return make


@pytest.fixture
def subject(make_arm, open_site):
    arm = make_arm()
    site = open_site(arm)
    subject = DriverSubject(open=lambda: PIPER.open(site), scene="cell", noise=0.005, reset=arm.reset)
    yield subject
    subject.close()


@pytest.mark.parametrize("check", DRIVER_CHECKS, ids=lambda check: check.__name__)
def test_the_driver_does_what_the_port_promises(subject, check):
    check(subject)


def test_an_arm_without_power_is_switched_on_and_commanded_to_where_it_lies(make_arm, open_site):
    arm = make_arm(LYING, powered=False)
    driver = PIPER.open(open_site(arm))
    driver.load(LoadScene("cell", 1, "e"))
    assert not arm.powered
    before = arm.plant.read()[0]
    driver.begin("s", 1)

    assert (arm.powered, arm.mode) == (True, 1)
    assert arm.plant.read()[0] == pytest.approx(before, abs=0.02)
    assert before[:6] == pytest.approx(LYING, abs=0.1)
    driver.close()


def test_after_an_emergency_stop_no_session_begins_until_a_person_has_reset_the_arm(make_arm, open_site):
    arm = make_arm()
    driver = PIPER.open(open_site(arm))
    driver.load(LoadScene("cell", 1, "e"))
    driver.begin("s", 1)
    driver.emergency_stop()
    frames = len(arm.bus.frames)
    with pytest.raises(
        ExecutionError, match=f"PROTECTIVE_STOP: {arm.channel}: the arm is in its emergency stop; support"
    ):
        driver.begin("t", 2)

    assert arm.is_stopped
    assert len(arm.bus.frames) == frames
    arm.reset()
    driver.begin("t", 2)
    assert arm.mode == 1
    driver.close()


def test_a_channel_is_opened_again_after_it_was_closed(make_arm, open_site):
    arm = make_arm()
    site = open_site(arm)
    for _ in range(2):
        driver = PIPER.open(site)
        driver.load(LoadScene("cell", 1, "e"))
        driver.close()


class Served:
    """The driver in this process, where the bus is, and a journey whose target it is, in others."""

    def __init__(self, site, tmp_path):
        key, workspace = make_key(), site.workspace
        registry, secret = workspace.target_registry, workspace.root / TOKENS / "piper"
        self._stops = stops = StopListener(workspace.signals.parent, site.clock)
        log = ReceiveLog(workspace.logs / "bus.jsonl", site.clock)
        served = ServedTarget(PIPER.open(site), log, is_estopped=stops.is_latched, keep_stop=stops.keep)
        door = WebSocketDoor()
        self._reach = lambda: ReachedTarget(lambda: connect_websocket(door.endpoint), key)
        told = f"driver: remote\nendpoint: {door.endpoint}\n"
        text = registry.read_text()
        old = f"driver: piper\nendpoint: {site.profile.endpoint}\n"
        assert old in text, text
        registry.write_text(text.replace(old, told))
        secret.parent.mkdir(parents=True)
        secret.touch(mode=0o600)
        secret.write_text(key.hex())
        arguments = (served, door, Tokens(key), site.clock)
        self._thread = threading.Thread(target=serve_realtime, args=arguments, daemon=True)
        self._thread.start()
        self.journey = Journey(workspace, "piper", tmp_path)

    def close(self):
        self.journey.close()
        self._reach().close()
        self._thread.join(10)
        self._stops.close()
        assert not self._thread.is_alive()


@pytest.fixture
def arm(make_arm):
    return make_arm()


@pytest.fixture
def journey(arm, open_site, tmp_path):
    served = Served(open_site(arm, control_period_s=0.1), tmp_path)
    yield served.journey
    served.close()


@pytest.mark.journey
def test_a_goal_is_carried_out_over_the_bus(arm, journey):
    report = journey.begin().finish()

    assert report.verdict == "success", report
    assert arm.bus.count(0x155) >= 200
    assert arm.swing == pytest.approx(0.15, abs=0.01)


@pytest.mark.journey
def test_an_emergency_stop_is_a_frame_that_a_third_node_sees(arm, journey):
    journey.begin()
    assert arm.bus.count(0x150) == 0
    journey.stop()

    wait_until(lambda: arm.is_stopped, "the stop", 5.0)
    assert arm.bus.count(0x150, 1) >= 1
    assert arm.bus.count(0x150, 2) == 0
    count = len(arm.bus.frames)
    SystemClock().sleep(0.5)
    assert len(arm.bus.frames) == count


@pytest.mark.journey
def test_a_cut_bus_ends_the_session_as_a_lost_target_that_names_the_channel(arm, journey):
    journey.begin()
    arm.cut()

    assert f"{arm.channel}: no feedback within 0.2 s; check cable, power and interface" in journey.explain_loss()


def test_an_interface_that_is_not_there_is_named(menagerie, need_package, make_site):
    need_package("piper_sdk")
    site = make_site("piper", menagerie / "agilex_piper", endpoint="nocan0")

    with pytest.raises(ExecutionError, match=r"TARGET_LOST: nocan0: \[Errno \d+\] .*; check cable and interface"):
        PIPER.open(site)
