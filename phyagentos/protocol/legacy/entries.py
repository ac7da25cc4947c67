"""What is read of the entries of 0.1.x: types and ranges of the fields that are converted.

Upstream: `conversion`. Every other field is told by the table in `fields`.
"""

from typing import Literal

import pydantic

from phyagentos.protocol.schema import Authored

Status = Literal[
    "pending", "claimed", "preflight_checking", "running", "finalizing", "awaiting_verification", "verifying",
    "awaiting_replan", "cancelling", "succeeded", "failed", "replanned", "timed_out", "cancelled", "rejected",
]  # fmt: skip


class Legacy(Authored):
    """Fields that are read; the table of fields tells about the others."""

    model_config = pydantic.ConfigDict(extra="ignore")


class LegacyState(Legacy):
    """Where a session stood; decides whether it is converted."""

    status: Status = "pending"


class LegacyTimeouts(Legacy):
    """Bounds of a session."""

    execute_timeout_s: float | None = pydantic.Field(default=None, gt=0)


class LegacyRetry(Legacy):
    """Budget of a session."""

    max_retries: int | None = pydantic.Field(default=None, ge=0)


class LegacySession(Legacy):
    """A pending session."""

    session_id: str
    goal_id: str | None = None
    depends_on: tuple[str, ...] | None = None
    target_ref: str = pydantic.Field(min_length=1)
    skillruntime_ref: str | None = None
    skill_ref: str | None = None
    task_description: str = ""
    priority: Literal["low", "normal", "high"] | None = None
    timeouts: LegacyTimeouts | None = None
    retry: LegacyRetry | None = None


class LegacyRuntime(Legacy):
    """How a target was reached."""

    runtime_contract_ref: str | None = None


class LegacyTarget(Legacy):
    """An entry of TARGETS.md."""

    id: str
    target_kind: Literal["game", "debug", "simulation", "real_robot"] | None = None
    type: Literal["sim", "real_robot"] | None = None
    embodiment: str | None = None
    runtime: LegacyRuntime | None = None


class LegacySkill(Legacy):
    """An entry of SKILLRUNTIME.md."""

    id: str
    runtime_kind: Literal["policy", "builtin"] = "builtin"


class LegacyAction(Legacy):
    """What a target accepted."""

    control_hz: float | None = pydantic.Field(default=None, gt=0)


class LegacyContract(Legacy):
    """A target's runtime contract."""

    target_id: str
    action_contract: LegacyAction | None = None
