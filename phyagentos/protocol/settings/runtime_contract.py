"""runtime_contract.yaml: what runtime and world agree on."""

from enum import StrEnum
from pathlib import Path
from typing import Literal

import pydantic

from phyagentos.protocol.documents.schema import Authored, misfit, read_yaml, validate
from phyagentos.protocol.settings.operations import SESSION_OPERATIONS, Operation
from phyagentos.protocol.settings.verification import Verification


class WorldMode(StrEnum):
    """How simulated time advances."""

    LOCKSTEP = "lockstep"
    """By commands only: a run can be repeated, bit for bit."""
    REALTIME = "realtime"
    """With the wall clock; a target without a command in time brings itself to rest."""


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
    drop: tuple[Literal["looks", "model", "pictures", "recording", "trace", "trajectory"], ...] = (
        "looks",
        "pictures",
        "recording",
        "trace",
        "trajectory",
    )
    max_bytes: int | None = pydantic.Field(default=None, gt=0)


class CameraRecording(Authored):
    """Pictures that every session keeps on its way, for those who learn from it; no judge reads them.

    Attributes:
        cameras: Names of sensors.yaml.
        rate_hz: In simulated time; the control rate divided by a whole number [Hz].
    """

    cameras: tuple[str, ...] = pydantic.Field(min_length=1)
    rate_hz: float = pydantic.Field(gt=0)


class Forecasting(Authored):
    """What forecasters are given, and when one is no longer asked; goal graphs name those that are (`lookahead`).

    Attributes:
        least_cases: From so many forecasts with a verdict on, one that did worse than the base rate in this workspace,
            by its Brier score, is not asked.
        options: What a forecaster is given, by its name: `learned: {model: ...}`.
    """

    least_cases: int = pydantic.Field(default=20, ge=2)
    options: dict[str, dict[str, str | float | bool]] = pydantic.Field(default_factory=dict)


class RuntimeContract(Authored):
    """runtime_contract.yaml: what runtime and world agree on.

    Attributes:
        version: Of this format.
        world_mode: How simulated time advances.
        control_period_s: Length of one command [s].
        physics_step_s: One step of the simulation, and one row of a command [s].
        command_representation: What a command holds.
        sampling_hz: How often hold conditions and constraints are sampled, in simulated time [Hz].
        operations: Operations of a target that a session may use here, if the target offers them.
        resources: What several targets can reach and one session at a time may have; a contract names no others.
        ageing_per_min: Priority that a waiting session gains in a minute. At 1, a session of priority 5 goes before an
            ordinary one that came up to five minutes earlier, and after it when it came later than that.
        lease_s: A worker without a message from its watchdog for so long brings its target to rest [s]. Longer than a
            slow disk keeps a watchdog busy, shorter than a person takes to wonder.
        evidence: How long evidence is kept.
        forecasting: How sessions are foreseen that ask for it.
        verification: Who judges sessions, and what a judgement is for.
        record: Cameras that are recorded all through; none without it.
        speed: Share of the velocity limits that motions are timed within; acceleration scales with its square. Session
            timeouts, guard and policies do not.
        memory: `project`: one memory for every run of a project; `workspace`: each workspace has its own; `none`; or a
            folder, relative to the workspace.
    """

    version: Literal[1] = 1
    world_mode: WorldMode
    control_period_s: float = pydantic.Field(gt=0)
    physics_step_s: float = pydantic.Field(gt=0)
    command_representation: Literal["joint_position_velocity"]
    sampling_hz: float = pydantic.Field(ge=10)
    operations: tuple[Operation, ...] = SESSION_OPERATIONS
    resources: tuple[str, ...] = ()
    ageing_per_min: float = pydantic.Field(default=1.0, gt=0)
    lease_s: float = pydantic.Field(default=15.0, ge=1.0)
    evidence: EvidenceRetention = EvidenceRetention()
    forecasting: Forecasting = Forecasting()
    verification: Verification = Verification()
    record: CameraRecording | None = None
    memory: str = pydantic.Field(default="project", min_length=1)
    speed: float = pydantic.Field(default=1.0, gt=0.0, le=1.0)

    @pydantic.model_validator(mode="after")
    def _check_record(self) -> "RuntimeContract":
        if self.record is not None:
            periods = 1.0 / (self.record.rate_hz * self.control_period_s)
            if periods < 0.999 or abs(periods - round(periods)) > 1e-6 * periods:
                fastest_hz = 1 / self.control_period_s
                whole = max(1, round(periods))
                hint = f"Write {fastest_hz / whole:g}."
                raise misfit("record.rate_hz", f"{fastest_hz:g} Hz divided by a whole number", hint)
        return self


def read_runtime_contract(path: Path) -> RuntimeContract:
    """Read runtime_contract.yaml; raises DefinitionError with every problem at file:line:column."""
    return validate(RuntimeContract, read_yaml(path))
