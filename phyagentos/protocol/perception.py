"""perception.yaml: how observations become the facts of ENVIRONMENT.md. People own it.

Upstream: a person. Downstream: the runtime's perception; hashed into every evidence bundle.
"""

from pathlib import Path
from typing import Literal

from phyagentos.errors import DefinitionError, format_hint, format_names
from phyagentos.protocol.schema import Authored, read_yaml, validate
from phyagentos.protocol.sensors import read_sensors


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


class Perception(Authored):
    """perception.yaml.

    Attributes:
        version: Of this format.
        sensing: `truth` reads the simulator's state; every verdict names it.
        pipelines: By name.
    """

    version: Literal[1] = 1
    sensing: Literal["truth"]
    pipelines: dict[str, Pipeline]


def read_perception(path: Path) -> Perception:
    """Read perception.yaml.

    Raises:
        DefinitionError: With every problem; also when it names a sensor that sensors.yaml beside it lacks.
    """
    located = read_yaml(path)
    perception = validate(Perception, located)
    beside = path.parent / "sensors.yaml"
    if beside.is_file():
        sensors = read_sensors(beside).sensors
        problems = [
            located.problem(
                "UNKNOWN_SENSOR",
                ("pipelines", name, "sensors", index),
                repr(sensor),
                format_names(sensors),
                format_hint(sensor, sensors),
            )
            for name, pipeline in perception.pipelines.items()
            for index, sensor in enumerate(pipeline.sensors)
            if sensor not in sensors
        ]
        if problems:
            raise DefinitionError(problems)
    return perception
