"""Drivers of real robots, as entry points announce them; a vendor's package is imported when one is opened."""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

from phyagentos.errors import DefinitionError, format_install
from phyagentos.runtime.targets.driver_registry import DriverSite, DriverSpec

if TYPE_CHECKING:
    from phyagentos.runtime.targets.driver import TargetDriver


def _import(package: str, driver: str, site: DriverSite) -> ModuleType:
    """A vendor's package; raises DefinitionError `NO_DRIVER` where it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise DefinitionError.of(
            "NO_DRIVER",
            address=f"{site.profile.target}/target.yaml: driver",
            found=f"no package {package!r} ({error})",
            expected=f"what driver {driver!r} needs",
            hint=format_install(driver),
        ) from error


def _open_so101(site: DriverSite) -> "TargetDriver":
    sdk = _import("scservo_sdk", "so101", site)
    from phyagentos.runtime.drivers.devices.device_driver import open_device
    from phyagentos.runtime.drivers.devices.so101_bus import So101Bus, So101Settings

    return open_device("so101", site, So101Settings, lambda settings: So101Bus(sdk, site.profile, settings))


SO101 = DriverSpec(open=_open_so101, kinds=("real_robot",))


def _open_piper(site: DriverSite) -> "TargetDriver":
    sdk = _import("piper_sdk", "piper", site)
    from phyagentos.runtime.drivers.devices.device_driver import open_device
    from phyagentos.runtime.drivers.devices.piper_bus import PiperBus, PiperSettings

    return open_device("piper", site, PiperSettings, lambda found: PiperBus(sdk, site.profile, found, site.clock))


PIPER = DriverSpec(open=_open_piper, kinds=("real_robot",))


def _open_go2(site: DriverSite) -> "TargetDriver":
    _import("cyclonedds", "go2", site)
    from phyagentos.runtime.drivers.devices.device_driver import open_device
    from phyagentos.runtime.drivers.devices.go2_bus import Go2Bus, Go2Settings

    return open_device("go2", site, Go2Settings, lambda settings: Go2Bus(site.profile, settings, site.clock))


GO2 = DriverSpec(open=_open_go2, kinds=("real_robot",))
