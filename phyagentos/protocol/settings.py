"""The settings files that people own: safety, sensors, perception, runtime contract.

Each is hashed into every evidence bundle. No skill, tree, prompt or memory can write them.
"""

import hashlib
from pathlib import Path
from typing import Literal

import pydantic

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.schema import Authored, read_yaml, validate

Provenance = Literal["controller_enforced", "planner_constrained", "site_policy", "measured"]


class Limit(Authored):
    """One bound with its origin; an unsourced limit is refused at load.

    Attributes:
        value: A number, or one number per joint, or a box as ((x, y, z), (x, y, z)) minimum and maximum.
        unit: `rad`, `rad/s`, `rad/s^2`, `m`, `1/s`, ...
        source: Where the number comes from (datasheet, standard, measurement).
        provenance: Who else stands behind it.
    """

    value: float | tuple[float, ...] | tuple[tuple[float, float, float], tuple[float, float, float]]
    unit: str
    source: str
    provenance: Provenance


class TargetLimits(Authored):
    """What the guard enforces for one target."""

    joint_position_min: Limit
    joint_position_max: Limit
    joint_velocity_max: Limit
    joint_acceleration_max: Limit
    workspace_box: Limit
    gripper_width_max: Limit
    command_rate_max: Limit
    tracking_error_max: Limit


class Safety(Authored):
    """safety.yaml."""

    version: Literal[1] = 1
    targets: dict[str, TargetLimits]


def read_safety(path: Path) -> Safety:
    """Read safety.yaml.

    Raises:
        DefinitionError: On any problem; an empty `source` is one.
    """
    located = read_yaml(path)
    safety = validate(Safety, located)
    problems = [
        located.problem("UNSOURCED_LIMIT", ("targets", target, name, "source"), "''", "where the number comes from")
        for target, limits in safety.targets.items()
        for name in TargetLimits.model_fields
        if not getattr(limits, name).source.strip()
    ]
    if problems:
        raise DefinitionError(problems)
    return safety


def get_target_limits(safety: Safety, target: str, source: str) -> TargetLimits:
    """The limits of one target.

    Raises:
        DefinitionError: When safety.yaml does not mention the target: nothing moves without limits.
    """
    if target not in safety.targets:
        raise DefinitionError(
            Problem(
                code="LIMITS_MISSING",
                address=source,
                found=f"no limits for target {target!r}",
                expected=format_names(safety.targets),
                hint=f"Add targets.{target} with a source for each limit.",
            )
        )
    return safety.targets[target]


def compute_file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


class Sensor(Authored):
    """One source of observations.

    Attributes:
        modality: What it measures.
        frame: Frame of its measurements.
        rate_hz: In the target's own time [Hz].
        provides: Names that a skill's `needs.observations` may ask for.
    """

    modality: Literal["simulator_state", "proprioception", "rgb", "depth", "contact"]
    frame: str = "world"
    rate_hz: float = pydantic.Field(gt=0)
    provides: tuple[str, ...]
    description: str = ""


class Sensors(Authored):
    """sensors.yaml."""

    version: Literal[1] = 1
    sensors: dict[str, Sensor]


class Pipeline(Authored):
    """How one kind of fact is made from sensors."""

    sensors: tuple[str, ...]
    produces: tuple[str, ...]
    description: str = ""


class Perception(Authored):
    """perception.yaml.

    Attributes:
        sensing: `truth` reads the simulator's state; every verdict names it.
    """

    version: Literal[1] = 1
    sensing: Literal["truth"]
    pipelines: dict[str, Pipeline]


class RuntimeContract(Authored):
    """runtime_contract.yaml: what both sides of the wire count on.

    Attributes:
        world_mode: `lockstep`: simulated time advances by commands only.
        sampling_hz: How often hold conditions and constraints are sampled, in simulated time [Hz].
    """

    version: Literal[1] = 1
    world_mode: Literal["lockstep"]
    control_period_s: float = pydantic.Field(gt=0)
    physics_step_s: float = pydantic.Field(gt=0)
    command_representation: Literal["joint_position_velocity"]
    sampling_hz: float = pydantic.Field(ge=10)


SETTINGS_FILES: dict[str, type[Authored]] = {
    "safety.yaml": Safety,
    "sensors.yaml": Sensors,
    "perception.yaml": Perception,
    "runtime_contract.yaml": RuntimeContract,
}


def check_settings(path: Path) -> None:
    """Check one of the settings files by its name.

    Raises:
        DefinitionError: With every problem; also when perception.yaml names a sensor that sensors.yaml beside it lacks.
    """
    if path.name == "safety.yaml":
        read_safety(path)
        return
    located = read_yaml(path)
    settings = validate(SETTINGS_FILES[path.name], located)
    if isinstance(settings, Perception) and (path.parent / "sensors.yaml").is_file():
        sensors = validate(Sensors, read_yaml(path.parent / "sensors.yaml")).sensors
        problems = [
            located.problem(
                "UNKNOWN_SENSOR",
                ("pipelines", name, "sensors", index),
                repr(sensor),
                format_names(sensors),
                format_hint(sensor, sensors),
            )
            for name, pipeline in settings.pipelines.items()
            for index, sensor in enumerate(pipeline.sensors)
            if sensor not in sensors
        ]
        if problems:
            raise DefinitionError(problems)
