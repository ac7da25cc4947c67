"""Every driver of the registry does what the port promises; a new one only needs a subject here."""

import contextlib
import threading
from pathlib import Path

import pytest

from phyagentos.assembly.drivers import build_driver_registry
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.drivers.debug import DebugDriver
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.conformance import CHECKS, Subject
from phyagentos.runtime.targets.driver_registry import DriverSite
from phyagentos.runtime.targets.handshake import Tokens, greet, make_key, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import serve
from phyagentos.runtime.targets.websocket import WebSocketDoor, connect_websocket

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks" / "library"
SUBJECTS = {"debug": ("counter", "counter"), "mujoco": ("panda", "tabletop/cubes_and_trays")}
REAL = {"so101"}  # tests/drivers: on emulated buses
REGISTRY = build_driver_registry()


@pytest.fixture
def open_driver(tmp_path):
    """Opens a driver as assembly does, in a workspace of its own."""

    def make(name):
        target, _ = SUBJECTS[name]
        workspace = Workspace.create(tmp_path / name, Library.open(BENCHMARKS))
        path = workspace.library().get_target(target)
        site = DriverSite(profile=read_target(path), folder=path.parent, workspace=workspace, clock=SystemClock())
        return lambda: REGISTRY.get(site.profile).open(site)

    return make


@pytest.fixture
def served():
    """Serves a driver at a WebSocket of this machine; gives the driver that reaches it."""
    with contextlib.ExitStack() as stack:

        def open_remote(driver, profile):
            tokens, door = Tokens(key := make_key()), WebSocketDoor()
            target = ServedTarget(driver, ReceiveLog(None), permits=tokens.permits)
            thread = threading.Thread(target=serve, args=(target, door, tokens, ended.is_set), daemon=True)
            thread.start()
            channel = connect_websocket(door.endpoint)
            greet(channel, mint(key))
            return RemoteDriver(profile, channel, key)

        ended = threading.Event()
        stack.callback(ended.set)
        yield open_remote


@pytest.fixture
def subject(request, open_driver, served):
    name = request.param
    if name == "remote":
        beyond = open_driver("debug")
        profile = read_target(Library.open(BENCHMARKS).get_target("counter"))
        subject = Subject(open=lambda: served(beyond(), profile), scene="counter")
    else:
        subject = Subject(open=open_driver(name), scene=SUBJECTS[name][1])
    yield subject
    subject.close()


def mark(name):
    return pytest.param(name, marks=[pytest.mark.sim] if name == "mujoco" else [])


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("subject", [mark(name) for name in sorted(set(REGISTRY.names()) - REAL)], indirect=True)
def test_a_driver_does_what_the_port_promises(subject, check):
    check(subject)


def test_every_driver_of_the_registry_has_a_subject():
    assert {*SUBJECTS, "remote"} == set(REGISTRY.names()) - REAL


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_the_port_demands_no_gripper(check):
    """A target whose flange carries nothing: its openings are zeros, and every promise stands."""
    told = read_target(Library.open(BENCHMARKS).get_target("counter")).model_dump(exclude={"gripper"})
    profile = TargetProfile.model_validate(told | {"end_effector": "none"})
    subject = Subject(open=lambda: DebugDriver(profile, Library.open(BENCHMARKS)), scene="counter")
    check(subject)
    assert subject.serve().ask(wire.Describe()).end_effector == "none"
    subject.close()


@pytest.mark.parametrize(("end_effector", "expected"), [("opening", "a gripper that opens"), ("suction", "no gripper")])
def test_a_profile_has_a_gripper_exactly_when_its_end_effector_opens(end_effector, expected):
    dropped = {"gripper"} if end_effector == "opening" else set()
    told = read_target(Library.open(BENCHMARKS).get_target("counter")).model_dump(exclude=dropped)
    with pytest.raises(ValueError, match=f"end_effector '{end_effector}' needs {expected}"):
        TargetProfile.model_validate(
            {k: v for k, v in told.items() if k not in dropped} | {"end_effector": end_effector}
        )


@pytest.mark.sim
def test_a_simulation_without_an_opening_gripper_is_refused_before_it_starts(open_driver, tmp_path):
    open_driver("mujoco")
    path = Library.open().get_target("panda")
    profile = read_target(path).model_copy(update={"end_effector": "suction"})
    site = DriverSite(
        profile=profile, folder=path.parent, workspace=Workspace.open(tmp_path / "mujoco"), clock=SystemClock()
    )
    with pytest.raises(DefinitionError, match="NO_DRIVER: found 'suction'; expected 'opening', for driver 'mujoco'"):
        REGISTRY.get(profile).open(site)
