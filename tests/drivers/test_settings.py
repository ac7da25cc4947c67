"""Settings of the shipped profiles are those that their drivers read; no vendor's package is needed for that."""

import importlib
import shutil

import pytest

from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.runtime.drivers.devices.device_driver import read_settings
from tests.drivers.conftest import PROFILES


@pytest.mark.parametrize("driver", ["so101", "piper"])
def test_a_shipped_profile_has_the_settings_of_its_driver(driver, tmp_path):
    (file := tmp_path / driver / "target.yaml").parent.mkdir()
    shutil.copy(PROFILES / f"{driver}.yaml", file)
    bus, profile = importlib.import_module(f"phyagentos.runtime.drivers.devices.{driver}_bus"), read_target(file)
    settings = read_settings(getattr(bus, f"{driver.capitalize()}Settings"), profile)
    assert len(settings.q_min_rad) == len(profile.arm.joints)
    assert driver != "so101" or settings.ids == (1, 2, 3, 4, 5)
