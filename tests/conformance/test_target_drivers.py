"""Every driver of the registry does what the port promises; a new one only needs a subject here."""

import contextlib
import importlib.util
import re
import shutil
import sys
import threading
from pathlib import Path

import pytest

from phyagentos.assembly.drivers import DRIVERS
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.drivers.debug import DebugDriver
from phyagentos.runtime.drivers.gymnasium import open_gymnasium
from phyagentos.runtime.drivers.kit import open_kit
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver_registry import DriverSite, find_driver
from phyagentos.runtime.targets.handshake import Tokens, greet, make_key, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import serve
from phyagentos.runtime.targets.websocket import WebSocketDoor, connect_websocket
from phyagentos.testing import DRIVER_CHECKS, DriverSubject

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "benchmarks" / "library"
SLIDE = ROOT / "examples" / "projects" / "05_any_body" / "slide.py"
SUBJECTS = {"debug": ("counter", "counter"), "mujoco": ("panda", "tabletop/cubes_and_trays")}
REAL = {"go2", "piper", "so101"}  # tests/drivers: on emulated buses


ENVIRONMENT = """
python: {python}
id: {id}
joints: {{slide: {{action: 0, low: {low}, high: {high}, set_point_gain: 1.0}}}}
"""


def write_environment(folder, python, id="Pendulum-v1", low=-2.0, high=2.0):
    """A target whose only joint is the action of a small environment."""
    folder = folder / "counter"
    folder.mkdir()
    told = Library.open(BENCHMARKS).get_target("counter").read_text()
    gripper = told[told.index("gripper:") : told.index("observations:")]
    changed = told.replace(gripper, "end_effector: none\n").replace("kind: debug", "kind: simulation")
    (folder / "target.yaml").write_text(changed + "driver: gymnasium\n")
    (folder / "gymnasium.yaml").write_text(ENVIRONMENT.format(python=python, id=id, low=low, high=high))
    return folder


def write_slide(folder):
    """The slide of an example, beside its profile."""
    folder = folder / "counter"
    folder.mkdir()
    shutil.copy(SLIDE, folder)
    told = Library.open(BENCHMARKS).get_target("counter").read_text().replace("kind: debug", "kind: simulation")
    (folder / "target.yaml").write_text(told + "driver: kit\nsettings: {module: slide}\n")
    return folder


@pytest.fixture
def open_driver(tmp_path):
    """Opens a driver as assembly does, in a workspace of its own."""

    def make(name):
        target, _ = SUBJECTS[name]
        workspace = Workspace.create(tmp_path / name, Library.open(BENCHMARKS))
        path = workspace.library().get_target(target)
        site = DriverSite(profile=read_target(path), folder=path.parent, workspace=workspace, clock=SystemClock())
        return lambda: find_driver(DRIVERS, site.profile).open(site)

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
def subject(request, open_driver, served, tmp_path, pytestconfig):
    name = request.param
    if name == "remote":
        beyond = open_driver("debug")
        profile = read_target(Library.open(BENCHMARKS).get_target("counter"))
        subject = DriverSubject(open=lambda: served(beyond(), profile), scene="counter")
    elif name == "gymnasium":
        folder = write_environment(tmp_path, pytestconfig.option.gymnasium_python)
        subject = DriverSubject(open=lambda: open_gymnasium(read_target(folder / "target.yaml"), folder), scene="any")
    elif name == "kit":
        folder = write_slide(tmp_path)
        subject = DriverSubject(open=lambda: open_kit(read_target(folder / "target.yaml"), folder), scene="counter")
    else:
        subject = DriverSubject(open=open_driver(name), scene=SUBJECTS[name][1])
    yield subject
    subject.close()


def mark(name):
    marks = {"mujoco": [pytest.mark.sim], "gymnasium": [pytest.mark.extras]}
    return pytest.param(name, marks=marks.get(name, []))


@pytest.mark.parametrize("check", DRIVER_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("subject", [mark(name) for name in sorted(set(DRIVERS.names()) - REAL)], indirect=True)
def test_a_driver_does_what_the_port_promises(subject, check):
    check(subject)


def test_every_driver_of_the_registry_has_a_subject():
    assert {*SUBJECTS, "remote", "gymnasium", "kit"} == set(DRIVERS.names()) - REAL


@pytest.mark.parametrize("check", DRIVER_CHECKS, ids=lambda check: check.__name__)
def test_the_port_demands_no_gripper(check):
    """A target whose flange carries nothing: its openings are zeros, and every promise stands."""
    told = read_target(Library.open(BENCHMARKS).get_target("counter")).model_dump(exclude={"gripper"})
    profile = TargetProfile.model_validate(told | {"end_effector": "none"})
    subject = DriverSubject(open=lambda: DebugDriver(profile, Library.open(BENCHMARKS)), scene="counter")
    check(subject)
    assert subject.serve().ask(wire.Describe()).end_effector == "none"
    subject.close()


@pytest.mark.parametrize(("end_effector", "expected"), [("opening", "a gripper that opens"), ("suction", "no gripper")])
def test_a_profile_has_a_gripper_exactly_when_its_end_effector_opens(end_effector, expected):
    dropped = {"gripper"} if end_effector == "opening" else set()
    told = read_target(Library.open(BENCHMARKS).get_target("counter")).model_dump(exclude=dropped)
    with pytest.raises(ValueError, match=f"'{end_effector}' needs {expected}"):
        TargetProfile.model_validate(
            {k: v for k, v in told.items() if k not in dropped} | {"end_effector": end_effector}
        )


@pytest.mark.sim
def test_a_simulation_with_a_suction_cup_is_refused_before_it_starts(open_driver, tmp_path):
    open_driver("mujoco")
    path = Library.open().get_target("panda")
    profile = read_target(path).model_copy(update={"end_effector": "suction"})
    site = DriverSite(
        profile=profile, folder=path.parent, workspace=Workspace.open(tmp_path / "mujoco"), clock=SystemClock()
    )
    with pytest.raises(
        DefinitionError, match="NO_DRIVER: found 'suction'; expected 'opening' or 'none', for driver 'mujoco'"
    ):
        find_driver(DRIVERS, profile).open(site)


@pytest.mark.parametrize(
    ("python", "found"),
    [("/no/such/python", "'/no/such/python': No such file or directory"), (sys.executable, "exit status 1")],
)
def test_an_environment_that_does_not_start_is_named_with_its_settings(tmp_path, python, found):
    if python == sys.executable and importlib.util.find_spec("gymnasium"):
        python, found = "false", "exit status 1"
    folder = write_environment(tmp_path, python)
    with pytest.raises(DefinitionError, match=f"gymnasium.yaml: NO_DRIVER: found {re.escape(found)}"):
        open_gymnasium(read_target(folder / "target.yaml"), folder)
