"""Every driver of the registry does what the port promises; a new one only needs a subject here."""

import contextlib
import threading
from pathlib import Path

import pytest

from phyagentos.assembly.drivers import build_driver_registry
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.targets.conformance import CHECKS, Subject
from phyagentos.runtime.targets.driver_registry import DriverSite
from phyagentos.runtime.targets.handshake import Tokens, greet, make_token
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import serve
from phyagentos.runtime.targets.websocket import WebSocketDoor, connect_websocket

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks" / "library"
SUBJECTS = {"debug": ("counter", "counter"), "mujoco": ("panda", "tabletop/cubes_and_trays")}
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
            token, door = make_token(), WebSocketDoor()
            target = ServedTarget(driver, ReceiveLog(None))
            thread = threading.Thread(target=serve, args=(target, door, Tokens(token), ended.is_set), daemon=True)
            thread.start()
            channel = connect_websocket(door.endpoint)
            greet(channel, token)
            return RemoteDriver(profile, channel)

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
@pytest.mark.parametrize("subject", [mark(name) for name in REGISTRY.names()], indirect=True)
def test_a_driver_does_what_the_port_promises(subject, check):
    check(subject)


def test_every_driver_of_the_registry_has_a_subject():
    assert {*SUBJECTS, "remote"} == set(REGISTRY.names())
