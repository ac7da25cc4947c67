"""What a client can do: the packages of the group `client`, and no others of those that a runtime needs."""

import importlib.metadata
import re
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
for command in sys.argv[1:]:
    sys.argv = ["paos", *command.split()]
    try:
        main()
    except SystemExit as ended:
        print(END, ended.code)
"""
END = "-- ended with"


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


def call(absent, *commands):
    """The process that carries commands out, and what each printed and ended with."""
    command = [sys.executable, "-c", WITHOUT.replace("END", repr(END)), ",".join(sorted(absent)), *commands]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120, check=True)
    return done, re.findall(rf"(.*?){END} (\d)\n", done.stdout, re.DOTALL)


READS = ("why red", "status", "context", "memory show", "approve", "graph")


@pytest.mark.slow
def test_a_workspace_is_read_without_what_a_runtime_needs(absent, workspace):
    assert {"mujoco", "scipy", "cv2", "numba", "casadi", "ompl"} <= absent
    done, printed = call(absent, *(f"{command} -w {workspace}" for command in READS))
    assert [code for _, code in printed] == [str(ExitCode.GOAL_MET)] * len(READS), done.stderr
    assert all(text for text, _ in printed)


@pytest.mark.slow
def test_what_needs_more_says_so(absent, workspace):
    done, ((_, code),) = call(absent, f"lint {ROOT / 'goal_graphs' / 'tidy_table.yaml'}")
    assert code == str(ExitCode.INVALID_INPUT)
    assert "is not installed here" in done.stderr
    assert "Traceback" not in done.stderr


def read_pins(name):
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    return {line.partition(" ;")[0].strip() for line in lines if "==" in line}


def test_the_lock_of_a_client_is_part_of_that_of_all():
    assert read_pins("requirements-client.lock") <= read_pins("requirements.lock")
