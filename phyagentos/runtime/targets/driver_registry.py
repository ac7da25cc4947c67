"""The registry of drivers, by the names that target profiles use.

A plug-in is a `DriverSpec` in the entry point group `phyagentos.drivers`; it imports nothing heavy before `open` is
called. Assembly registers the shipped drivers, since drivers import this room and never the reverse.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, format_hint, format_names
from phyagentos.protocol.capabilities.targets import TargetProfile, find_driver_name
from phyagentos.protocol.workspace.workspace import Workspace

if TYPE_CHECKING:
    from phyagentos.runtime.targets.driver import TargetPort

ENTRY_POINT_GROUP = "phyagentos.drivers"


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
    worker.
    """

    open: "Callable[[DriverSite], TargetPort]"
    kinds: tuple[str, ...]
    own_process: bool = True


@dataclass(slots=True)
class DriverRegistry:
    """Specifications by name."""

    _specs: dict[str, DriverSpec] = field(default_factory=dict)

    def register(self, name: str, spec: DriverSpec) -> None:
        """Add one; raises ValueError when the name is taken."""
        if name in self._specs:
            raise ValueError(f"driver {name!r} is registered already")
        self._specs[name] = spec

    def names(self) -> list[str]:
        """Every name, sorted."""
        return sorted(self._specs)

    def load_plug_ins(self) -> None:
        """Add what installed packages announce."""
        for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
            self.register(point.name, point.load())

    def get(self, profile: TargetProfile, address: str = "TARGETS.md") -> DriverSpec:
        """The driver that moves a target; raises DefinitionError `NO_DRIVER`."""
        name = find_driver_name(profile)
        spec = self._specs.get(name)
        if spec is not None and profile.kind in spec.kinds:
            return spec
        possible = [each for each, known in self._specs.items() if profile.kind in known.kinds]
        found = f"driver {name!r} for kind {profile.kind!r}" if name else f"kind {profile.kind!r} without a driver"
        expected = format_names(possible)
        hint = format_hint(name, possible) or "Name one that moves this kind, or install its package."
        raise DefinitionError.of("NO_DRIVER", f"{address}: {profile.target}.driver", found, expected, hint)
