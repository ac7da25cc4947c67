"""Drivers of real robots, as entry points announce them; a vendor's package is imported when one is opened."""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

from phyagentos.errors import DefinitionError
from phyagentos.runtime.targets.driver_registry import DriverSite, DriverSpec

if TYPE_CHECKING:
    from phyagentos.runtime.targets.driver import TargetDriver


def _import(package: str, driver: str, site: DriverSite) -> ModuleType:
    """A vendor's package; raises DefinitionError `NO_DRIVER` where it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        hint = f"Install it: pip install 'phyagentos[{driver}]'."
        found = f"no package {package!r} ({error})"
        address = f"{site.profile.target}/target.yaml: driver"
        raise DefinitionError.of("NO_DRIVER", address, found, f"what driver {driver!r} needs", hint) from error


def _open_so101(site: DriverSite) -> "TargetDriver":
    sdk = _import("scservo_sdk", "so101", site)
    from phyagentos.runtime.drivers.devices.device_driver import DeviceDriver, read_settings
    from phyagentos.runtime.drivers.devices.so101_bus import So101Bus, So101Settings
    from phyagentos.runtime.drivers.devices.tool_centre import ToolCentre

    settings, point = read_settings(So101Settings, site.profile), ToolCentre(site.profile, site.folder)
    return DeviceDriver("so101", site, So101Bus(sdk, site.profile, settings), settings, point)


SO101 = DriverSpec(open=_open_so101, kinds=("real_robot",))


def _open_piper(site: DriverSite) -> "TargetDriver":
    sdk = _import("piper_sdk", "piper", site)
    from phyagentos.runtime.drivers.devices.device_driver import DeviceDriver, read_settings
    from phyagentos.runtime.drivers.devices.piper_bus import PiperBus, PiperSettings
    from phyagentos.runtime.drivers.devices.tool_centre import ToolCentre

    settings, point = read_settings(PiperSettings, site.profile), ToolCentre(site.profile, site.folder)
    return DeviceDriver("piper", site, PiperBus(sdk, site.profile, settings, site.clock), settings, point)


PIPER = DriverSpec(open=_open_piper, kinds=("real_robot",))


def _open_go2(site: DriverSite) -> "TargetDriver":
    _import("cyclonedds", "go2", site)
    from phyagentos.runtime.drivers.devices.device_driver import DeviceDriver, read_settings
    from phyagentos.runtime.drivers.devices.go2_bus import Go2Bus, Go2Settings
    from phyagentos.runtime.drivers.devices.tool_centre import ToolCentre

    settings, point = read_settings(Go2Settings, site.profile), ToolCentre(site.profile, site.folder)
    return DeviceDriver("go2", site, Go2Bus(site.profile, settings, site.clock), settings, point)


GO2 = DriverSpec(open=_open_go2, kinds=("real_robot",))
