"""The settings files that people own: safety, sensors, perception, runtime contract.

Each is hashed into every evidence bundle. No skill, tree, prompt or memory can write them.
"""

import hashlib
from pathlib import Path
from typing import Literal

from phyagentos.errors import DefinitionError, Problem, format_names
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
