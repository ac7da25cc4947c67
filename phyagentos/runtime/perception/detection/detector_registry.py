"""The registry of detectors, by the names that perception.yaml uses.

A plug-in is a factory `(settings) -> Detector`, announced by the entry point group `phyagentos.detectors`; importing
this module registers nothing.
"""

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points

from phyagentos.errors import DefinitionError
from phyagentos.runtime.perception.detection.detector import Detector
from phyagentos.runtime.perception.detection.http import open_http_detector

ENTRY_POINT_GROUP = "phyagentos.detectors"

Factory = Callable[[Mapping[str, str | float]], Detector]


class DetectorRegistry:
    """Factories by name."""

    def __init__(self) -> None:
        self._factories: dict[str, Factory] = {}

    def register(self, name: str, factory: Factory) -> None:
        """Add one; raises ValueError when the name is taken."""
        if name in self._factories:
            raise ValueError(f"detector {name!r} is registered already")
        self._factories[name] = factory

    def names(self) -> list[str]:
        """Every name, sorted."""
        return sorted(self._factories)

    def open(self, name: str, settings: Mapping[str, str | float], address: str = "perception.yaml") -> Detector:
        """A detector by name; raises DefinitionError `UNKNOWN_DETECTOR`, or the factory's problem with the settings."""
        if name not in self._factories:
            raise DefinitionError.unknown("UNKNOWN_DETECTOR", address, name, self._factories)
        return self._factories[name](settings)


def build_detector_registry() -> DetectorRegistry:
    """The shipped detectors, and those of installed packages."""
    registry = DetectorRegistry()
    registry.register("http", open_http_detector)
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
        registry.register(point.name, point.load())
    return registry
