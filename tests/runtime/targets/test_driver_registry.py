"""Which driver moves a target: found by name, and refused before anything starts where there is none."""

import shutil
import sys
from pathlib import Path

import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.plugins import Plugins
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.targets import find_driver_name
from phyagentos.runtime.drivers import devices
from phyagentos.runtime.drivers.devices import specs
from phyagentos.runtime.targets.driver_registry import DriverSite, DriverSpec, find_driver


@pytest.fixture
def panda():
    return read_target(Library.open().get_target("panda"))


def open_nothing(_site):
    raise AssertionError("nothing is opened to find a driver")


@pytest.mark.parametrize(("kind", "name"), [("simulation", "mujoco"), ("debug", "debug"), ("real_robot", "")])
def test_a_kind_has_its_driver_unless_the_profile_names_one(panda, kind, name):
    profile = panda.model_copy(update={"kind": kind})

    assert find_driver_name(profile) == name
    assert find_driver_name(profile.model_copy(update={"driver": "mine"})) == "mine"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "real_robot"}, r"NO_DRIVER: found kind 'real_robot' without a driver; expected ur5\. Name one"),
        ({"kind": "real_robot", "driver": "mujoco"}, "found driver 'mujoco' for kind 'real_robot'; expected ur5"),
        ({"kind": "real_robot", "driver": "ur6"}, r"expected ur5\. Did you mean 'ur5'\?"),
        ({"driver": "mujocco"}, r"expected mujoco\. Did you mean 'mujoco'\?"),
    ],
)
def test_what_no_driver_moves_is_refused_with_the_names_that_are_possible(panda, changes, message):
    kinds = {"mujoco": ("simulation",), "ur5": ("real_robot",)}
    drivers = Plugins("-", {name: DriverSpec(open=open_nothing, kinds=each) for name, each in kinds.items()})

    with pytest.raises(DefinitionError, match=message):
        find_driver(drivers, panda.model_copy(update=changes))
    assert find_driver(drivers, panda).kinds == ("simulation",)


@pytest.mark.parametrize(("name", "package"), [("so101", "scservo_sdk"), ("piper", "piper_sdk"), ("go2", "cyclonedds")])
def test_a_real_robot_whose_package_is_absent_is_refused_with_its_extra(monkeypatch, tmp_path, name, package):
    monkeypatch.setitem(sys.modules, package, None)
    folder = tmp_path / name
    folder.mkdir()
    shutil.copy(Path(devices.__file__).parent / f"{name}.yaml", folder / "target.yaml")
    profile = read_target(folder / "target.yaml")
    site = DriverSite(profile=profile, folder=folder, workspace=None, clock=SystemClock())

    assert (profile.kind, profile.driver) == ("real_robot", name)
    with pytest.raises(DefinitionError, match="NO_DRIVER") as caught:
        getattr(specs, name.upper()).open(site)
    assert f"pip install '.[{name}]'" in str(caught.value)
