"""sensors.yaml: what can be observed in this workspace, and how often."""

from pathlib import Path
from typing import Literal

import pydantic

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.schema import Authored, read_yaml, validate
from phyagentos.protocol.settings.cameras import CameraBackend, CameraSettings, NoiseLevel

PERFECT = "none"  # the noise level that every file has
Modality = Literal["simulator_state", "proprioception", "rgb", "depth", "rgbd", "contact"]
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
        camera: The camera that it is, for the modality `rgbd`.
        description: One sentence for people.
    """

    modality: Modality
    frame: str = "world"
    rate_hz: float = pydantic.Field(gt=0)
    provides: tuple[str, ...]
    signals: dict[str, Signal] = {}
    camera: CameraSettings | None = None
    description: str = ""

    @pydantic.model_validator(mode="after")
    def _check_camera(self) -> "Sensor":
        if (self.modality == "rgbd") != (self.camera is not None):
            raise ValueError("a sensor of the modality rgbd has a camera, and no other has one")
        return self


class Sensors(Authored):
    """sensors.yaml.

    Attributes:
        version: Of this format.
        sensors: By name.
        backend: How simulated cameras see: `ray` casts rays and needs no graphics, `render` draws with them.
        synchronised: Whether all cameras expose at the same moments; otherwise each from its own `phase_s` on.
        noise_level: Which of `noise_levels` spoils their pictures; `none` is always there.
        noise_levels: By name.
    """

    version: Literal[1] = 1
    sensors: dict[str, Sensor]
    backend: CameraBackend = "ray"
    synchronised: bool = True
    noise_level: str = PERFECT
    noise_levels: dict[str, NoiseLevel] = {}

    @property
    def cameras(self) -> dict[str, Sensor]:
        """The RGB-D cameras, by name."""
        return {name: sensor for name, sensor in self.sensors.items() if sensor.camera is not None}

    def get_noise(self, level: str = "") -> NoiseLevel:
        """A noise level by its name; the chosen one when none is given. Raises KeyError for an unknown one."""
        name = level or self.noise_level
        return self.noise_levels.get(name, NoiseLevel()) if name == PERFECT else self.noise_levels[name]


def find_sensor(sensors: Sensors, observation: str) -> tuple[str, Sensor] | None:
    """The first sensor that provides an observation, with its name."""
    return next(((name, each) for name, each in sensors.sensors.items() if observation in each.provides), None)


def find_source(sensors: Sensors, observation: str, frame: str) -> tuple[str, Sensor] | None:
    """The sensor that provides an observation in a frame; the first one that provides it at all where none does."""
    found = ((name, s) for name, s in sensors.sensors.items() if observation in s.provides and s.frame == frame)
    return next(found, find_sensor(sensors, observation))


def read_sensors(path: Path) -> Sensors:
    """Read sensors.yaml; raises DefinitionError with every problem at file:line:column."""
    located = read_yaml(path)
    sensors = validate(Sensors, located)
    levels = dict.fromkeys((PERFECT, *sensors.noise_levels))
    if sensors.noise_level not in levels:
        raise DefinitionError(located.unknown("UNKNOWN_NOISE_LEVEL", ("noise_level",), sensors.noise_level, levels))
    return sensors
