"""The detectors by the names that perception.yaml uses; each is a factory `(settings) -> Detector`."""

from collections.abc import Callable, Mapping

from phyagentos.plugins import Plugins
from phyagentos.runtime.perception.detection.detector import Detector
from phyagentos.runtime.perception.detection.http import open_http_detector

Factory = Callable[[Mapping[str, str | float]], Detector]
DETECTORS = Plugins[Factory]("phyagentos.detectors", {"http": open_http_detector}, noun="detector")


def open_detector(name: str, settings: Mapping[str, str | float], address: str = "perception.yaml") -> Detector:
    """A detector by name; raises DefinitionError as `Plugins.load`, or the factory's problem with the settings."""
    return DETECTORS.load(name, address)(settings)
