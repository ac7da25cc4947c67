"""The modules that extensions are written with: sorted names that are there, and no simulator behind them."""

import subprocess
import sys
from importlib import import_module

import pytest

FACADES = ("drivers", "judges", "policies", "predicates", "skills", "testing")
SIMULATORS = {"mujoco", "mink", "ompl", "toppra", "casadi", "numba"}
OF_THE_RUNTIME = SIMULATORS | {"py_trees", "phyagentos.runtime"}


def list_loaded(code):
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


@pytest.mark.parametrize("name", FACADES)
def test_every_name_of_a_facade_is_there_and_sorted(name):
    facade = import_module(f"phyagentos.{name}")

    assert facade.__all__ == sorted(facade.__all__, key=lambda each: (not each.isupper(), not each[0].isupper(), each))
    assert all(getattr(facade, each) is not None for each in facade.__all__)
    assert facade.__doc__.count("from phyagentos."), "no example"


@pytest.mark.slow
def test_no_facade_loads_a_simulator():
    code = "\n".join(f"import phyagentos.{each}" for each in FACADES)
    assert not SIMULATORS & list_loaded(code)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["judges", "predicates"])
def test_what_the_agent_plane_is_extended_with_loads_nothing_of_the_runtime(name):
    assert not OF_THE_RUNTIME & list_loaded(f"import phyagentos.{name}")


def test_a_double_of_time_loads_nothing_of_the_runtime():
    assert not OF_THE_RUNTIME & list_loaded("from phyagentos.testing import ManualClock, make_contract")
