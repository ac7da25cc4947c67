"""sensors.yaml: what can be observed in this workspace, and how often. People own it.

Upstream: a person. Downstream: perception.yaml, which names these sensors; preflight, which compares them with what a
skill or policy takes; hashed into every evidence bundle.
"""

from pathlib import Path
from typing import Literal

import pydantic

from phyagentos.protocol.schema import Authored, read_yaml, validate

Modality = Literal["simulator_state", "proprioception", "rgb", "depth", "contact"]
ElementType = Literal["float64", "float32", "uint8", "uint16", "int32", "bool"]
Length = int | Literal["n_joints"]


class Signal(Authored):
    """The form of one measurement, where it is an array.

    Attributes:
        shape: Lengths of its axes; empty for one number. `n_joints` is the target's number of joints.
        dtype: Of its elements.
        unit: Of its elements, empty for none.
    """

    shape: tuple[Length, ...] = ()
    dtype: ElementType = "float64"
    unit: str = ""


class Sensor(Authored):
    """One source of observations.

    Attributes:
        modality: What it measures.
        frame: Frame of its measurements.
        rate_hz: In the target's own time [Hz].
        provides: What it measures, by the names that perception.yaml and skills use.
        signals: The form of what it measures, by these names; a policy needs it, a tree does not.
        description: One sentence for people.
    """

    modality: Modality
    frame: str = "world"
    rate_hz: float = pydantic.Field(gt=0)
    provides: tuple[str, ...]
    signals: dict[str, Signal] = {}
    description: str = ""


class Sensors(Authored):
    """sensors.yaml.

    Attributes:
        version: Of this format.
        sensors: By name.
    """

    version: Literal[1] = 1
    sensors: dict[str, Sensor]


def read_sensors(path: Path) -> Sensors:
    """Read sensors.yaml.

    Raises:
        DefinitionError: With every problem of the file.
    """
    return validate(Sensors, read_yaml(path))
