"""runtime_contract.yaml: what both sides of the wire between runtime and world count on. People own it.

Upstream: a person. Downstream: `retention` reads how long evidence is kept; preflight compares the other values with
every target. Hashed into every evidence bundle.
"""

from pathlib import Path
from typing import Literal

import pydantic

from phyagentos.protocol.operations import SESSION_OPERATIONS, Operation
from phyagentos.protocol.schema import Authored, read_yaml, validate


class EvidenceRetention(Authored):
    """What a clean-up may take out of bundles of succeeded sessions; every other bundle stays whole.

    Attributes:
        keep_last: So many of the newest succeeded sessions stay whole.
        keep_days: Those younger than this stay whole too.
        drop: What is taken out; contract, snapshots, held conditions, events and the manifest always stay.
        max_bytes: Above this, bundles of succeeded sessions are thinned from the oldest on, kept or not; at last their
            models go too. None: no bound.
    """

    keep_last: int = pydantic.Field(default=200, ge=0)
    keep_days: float = pydantic.Field(default=30.0, ge=0)
    drop: tuple[Literal["model", "pictures", "trace", "trajectory"], ...] = ("pictures", "trace", "trajectory")
    max_bytes: int | None = pydantic.Field(default=None, gt=0)


class RuntimeContract(Authored):
    """runtime_contract.yaml: what both sides of the wire count on.

    Attributes:
        version: Of this format.
        world_mode: `lockstep`: simulated time advances by commands only.
        control_period_s: Length of one command [s].
        physics_step_s: One step of the simulation, and one row of a command [s].
        command_representation: What a command holds.
        sampling_hz: How often hold conditions and constraints are sampled, in simulated time [Hz].
        operations: Operations of a target that a session may use here, if the target offers them.
        evidence: How long evidence is kept.
    """

    version: Literal[1] = 1
    world_mode: Literal["lockstep"]
    control_period_s: float = pydantic.Field(gt=0)
    physics_step_s: float = pydantic.Field(gt=0)
    command_representation: Literal["joint_position_velocity"]
    sampling_hz: float = pydantic.Field(ge=10)
    operations: tuple[Operation, ...] = SESSION_OPERATIONS
    evidence: EvidenceRetention = EvidenceRetention()


def read_runtime_contract(path: Path) -> RuntimeContract:
    """Read runtime_contract.yaml.

    Raises:
        DefinitionError: With every problem of the file.
    """
    return validate(RuntimeContract, read_yaml(path))
