"""What announces a driver, and which driver moves a target, by the names that target profiles use.

A plug-in is a `DriverSpec` in the entry point group `phyagentos.drivers`; it imports nothing heavy before `open` is
called. Assembly names the shipped drivers, since drivers import this room and never the reverse.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, format_hint, format_names
from phyagentos.plugins import Plugins
from phyagentos.protocol.capabilities.targets import TargetProfile, find_driver_name
from phyagentos.protocol.workspace.workspace import Workspace

if TYPE_CHECKING:
    from phyagentos.runtime.targets.driver import TargetPort

ENTRY_POINT_GROUP = "phyagentos.drivers"
Ask = Callable[[str], None]  # requests something of the person at the robot, and returns when it is done


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverSite:
    """What a driver is opened with; `profile.model` is relative to `folder`."""

    profile: TargetProfile
    folder: Path
    workspace: Workspace
    clock: Clock


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverSpec:
    """How a driver is opened, and the kinds of targets that it moves: a simulation never replaces a real robot.

    `own_process` is whether it runs in a process of its own, which outlives workers and keeps real time, or in the
    worker. `calibrate` measures, with a person at the robot, the `settings` of its profile that differ by device.
    """

    open: "Callable[[DriverSite], TargetPort]"
    kinds: tuple[str, ...]
    own_process: bool = True
    calibrate: "Callable[[TargetProfile, Path, Clock, Ask], Mapping[str, object]] | None" = None


def find_driver(drivers: Plugins[DriverSpec], profile: TargetProfile, address: str = "TARGETS.md") -> DriverSpec:
    """The driver that moves a target; raises DefinitionError `NO_DRIVER`, or `BROKEN_PYTHON` where it does not load."""
    name = find_driver_name(profile)
    if name in drivers.names() and profile.kind in drivers.load(name).kinds:
        return drivers.load(name)
    possible = [each for each, known in drivers.load_all().items() if profile.kind in known.kinds]
    raise DefinitionError.of(
        "NO_DRIVER",
        f"{address}: {profile.target}.driver",
        found=f"driver {name!r} for kind {profile.kind!r}" if name else f"kind {profile.kind!r} without a driver",
        expected=format_names(possible),
        hint=format_hint(name, possible) or "Name one that moves this kind, or install its package.",
    )
