"""Drivers of real robots, as entry points announce them; a vendor's package is imported when one is opened."""

import importlib
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, format_install
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.targets.driver_registry import Ask, DriverSite, DriverSpec

if TYPE_CHECKING:
    from phyagentos.runtime.targets.driver import TargetDriver


def _import(package: str, driver: str, profile: TargetProfile) -> ModuleType:
    """A vendor's package; raises DefinitionError `NO_DRIVER` where it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise DefinitionError.of(
            "NO_DRIVER",
            address=f"{profile.target}/target.yaml: driver",
            found=f"no package {package!r} ({error})",
            expected=f"what driver {driver!r} needs",
            hint=format_install(driver),
        ) from error


def _open_so101(site: DriverSite) -> "TargetDriver":
    sdk = _import("scservo_sdk", "so101", site.profile)
    from phyagentos.runtime.drivers.devices.device_driver import open_device
    from phyagentos.runtime.drivers.devices.so101_bus import So101Settings, open_so101

    return open_device("so101", site, So101Settings, lambda settings: open_so101(sdk, site.profile, settings))


def _calibrate_so101(profile: TargetProfile, folder: Path, clock: Clock, ask: Ask) -> Mapping[str, object]:
    sdk = _import("scservo_sdk", "so101", profile)
    from phyagentos.runtime.drivers.devices.so101_calibration import calibrate_so101

    return calibrate_so101(sdk, profile, folder, clock, ask)


SO101 = DriverSpec(open=_open_so101, kinds=("real_robot",), calibrate=_calibrate_so101)


def _open_piper(site: DriverSite) -> "TargetDriver":
    sdk = _import("piper_sdk", "piper", site.profile)
    from phyagentos.runtime.drivers.devices.device_driver import open_device
    from phyagentos.runtime.drivers.devices.piper_bus import PiperBus, PiperSettings

    return open_device("piper", site, PiperSettings, lambda found: PiperBus(sdk, site.profile, found, site.clock))


PIPER = DriverSpec(open=_open_piper, kinds=("real_robot",))


def _open_go2(site: DriverSite) -> "TargetDriver":
    _import("cyclonedds", "go2", site.profile)
    from phyagentos.runtime.drivers.devices.device_driver import open_device
    from phyagentos.runtime.drivers.devices.go2_bus import Go2Bus, Go2Settings

    return open_device("go2", site, Go2Settings, lambda settings: Go2Bus(site.profile, settings, site.clock))


GO2 = DriverSpec(open=_open_go2, kinds=("real_robot",))
