"""What a client can do: the packages of the group `client`, and no others of those that a runtime needs."""

import importlib.metadata
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from phyagentos.cli.outcome import ExitCode
from tests.stored_workspace import unpack_stored

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
WITHOUT = """
import sys
absent = set(sys.argv.pop(1).split(","))
class Absent:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in absent:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
from phyagentos.cli.app import main
main()
"""


def name_distributions(wanted):
    return {canonicalize_name(Requirement(text).name) for text in wanted}


@pytest.fixture(scope="module")
def absent():
    """The top-level modules of all requirements that no client has."""
    everything = name_distributions(PROJECT["project"]["dependencies"])
    missing = everything - name_distributions(PROJECT["dependency-groups"]["client"])
    found = importlib.metadata.packages_distributions().items()
    return {module for module, brought_by in found if missing & {canonicalize_name(each) for each in brought_by}}


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    return unpack_stored(tmp_path_factory.mktemp("client"))


def call(absent, *arguments):
    command = [sys.executable, "-c", WITHOUT, ",".join(sorted(absent)), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120, check=False)


READS = ("why red", "status", "context", "memory show", "approve", "graph")


@pytest.mark.slow
@pytest.mark.parametrize("command", READS)
def test_a_workspace_is_read_without_what_a_runtime_needs(absent, workspace, command):
    assert {"mujoco", "scipy", "cv2", "numba", "casadi", "ompl"} <= absent
    done = call(absent, *command.split(), "-w", workspace)
    assert done.returncode == ExitCode.GOAL_MET, done.stderr
    assert done.stdout


@pytest.mark.slow
def test_what_needs_more_says_so(absent, workspace):
    done = call(absent, "lint", ROOT / "goal_graphs" / "tidy_table.yaml")
    assert done.returncode == ExitCode.INVALID_INPUT
    assert "is not installed here" in done.stderr
    assert "Traceback" not in done.stderr


def read_pins(name):
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    return {line.partition(" ;")[0].strip() for line in lines if "==" in line}


def test_the_lock_of_a_client_is_part_of_that_of_all():
    assert read_pins("requirements-client.lock") <= read_pins("requirements.lock")
