"""perception.yaml: how observations become the facts of ENVIRONMENT.md."""

from enum import StrEnum
from pathlib import Path
from typing import Literal

import pydantic

from phyagentos.errors import raise_any
from phyagentos.protocol.documents.schema import Authored, read_yaml, validate
from phyagentos.protocol.settings.sensors import read_sensors


class Sensing(StrEnum):
    """What the agent and the verifier see."""

    PERCEIVED = "perceived"
    """What the pipelines make of cameras, joints and touch."""
    TRUTH = "truth"
    """The simulator's own state: for tests, and where nothing is to be perceived."""


class Prior(StrEnum):
    """What perception knows of a world before its first look."""

    FULL = "full"
    """Forms, sizes and colours of all objects, and the map: where fixed bodies stand."""
    SHAPES = "shapes"
    """Forms and sizes of all objects, and the map; no colours: an object is recognised by its form alone."""
    NONE = "none"
    """Nothing but what is seen: a level surface, and objects without a name."""


class Pipeline(Authored):
    """How one kind of fact is made from sensors.

    Attributes:
        sensors: Names in sensors.yaml.
        produces: The facts that it makes.
        description: One sentence for people.
    """

    sensors: tuple[str, ...]
    produces: tuple[str, ...]
    description: str = ""


class Embedded(Authored):
    """Settings of the embedded pipeline.

    Attributes:
        max_age_s: Older frames are not used [s].
    """

    max_age_s: float = pydantic.Field(default=0.3, gt=0.0, le=5.0)


class DetectorChoice(Authored):
    """A detector that distinguishes objects by words, where their colours do not.

    Attributes:
        name: `http`, or what an installed package announces (entry points `phyagentos.detectors`).
        settings: Of the detector; those of `http` are url, timeout_s, score_min.
    """

    name: str
    settings: dict[str, str | float] = {}


class Perception(Authored):
    """perception.yaml.

    Attributes:
        version: Of this format.
        sensing: `perceived` believes the cameras; `truth` reads the simulator's state. Every verdict names it.
        prior: What is known before the first look; read where the sensing is `perceived`.
        pipelines: By name.
        embedded: Settings of the pipeline that ships.
        detector: Instead of colours; absent for none.
    """

    version: Literal[1] = 1
    sensing: Sensing
    prior: Prior = Prior.FULL
    pipelines: dict[str, Pipeline]
    embedded: Embedded = Embedded()
    detector: DetectorChoice | None = None


def read_perception(path: Path) -> Perception:
    """Read perception.yaml beside sensors.yaml; raises DefinitionError with every problem at file:line:column."""
    located = read_yaml(path)
    perception = validate(Perception, located)
    beside = path.parent / "sensors.yaml"
    if beside.is_file():
        sensors = read_sensors(beside).sensors
        problems = [
            located.unknown("sensor", ("pipelines", name, "sensors", index), sensor, sensors)
            for name, pipeline in perception.pipelines.items()
            for index, sensor in enumerate(pipeline.sensors)
            if sensor not in sensors
        ]
        raise_any(problems)
    return perception
