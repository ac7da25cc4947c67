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


def load_factories() -> dict[str, Factory]:
    """The shipped detectors, and those of installed packages; raises ValueError when a name is taken."""
    factories: dict[str, Factory] = {"http": open_http_detector}
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
        if point.name in factories:
            raise ValueError(f"detector {point.name!r} is registered already")
        factories[point.name] = point.load()
    return factories


def open_detector(name: str, settings: Mapping[str, str | float], address: str = "perception.yaml") -> Detector:
    """A detector by name; raises DefinitionError `UNKNOWN_DETECTOR`, or the factory's problem with the settings."""
    factories = load_factories()
    if name not in factories:
        raise DefinitionError.unknown("UNKNOWN_DETECTOR", address, name, factories)
    return factories[name](settings)
