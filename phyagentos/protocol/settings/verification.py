"""The block `verification` of runtime_contract.yaml: the judges of sessions, and what a judgement is for.

No data leaves the machine unless `vision` is configured here and named among the judges.
"""

from enum import StrEnum
from functools import partial
from typing import Annotated, Self

import pydantic

from phyagentos.errors import get_known
from phyagentos.plugins import Plugins
from phyagentos.protocol.documents.schema import Authored, admit
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.settings.verification_mode import VerificationMode

JUDGE_ENTRY_POINTS = "phyagentos.judges"
"""Entry point group in which installed packages announce judges."""


class JudgeName(StrEnum):
    """Who can be asked."""

    PREDICATES = "predicates"
    """Acceptance, on the snapshots before and after."""
    HOLDS = "holds"
    """What had to hold all through, on the worst samples."""
    METRICS = "metrics"
    """Numbers that were measured on the way."""
    LOOKAHEAD = "lookahead"
    """The chance that was simulated before; it advises."""
    VISION = "vision"
    """A model that looks at the pictures before and after."""


JudgeOption = str | float | bool
DEFAULT_JUDGES: tuple[str, ...] = (JudgeName.PREDICATES, JudgeName.HOLDS, JudgeName.METRICS, JudgeName.LOOKAHEAD)


def _require_judge(name: str) -> None:
    """Raises DefinitionError `UNKNOWN_NAME` of a judge that neither ships nor is installed; none is loaded."""
    if name not in set(JudgeName):
        get_known("judge", "", name, dict.fromkeys(Plugins(JUDGE_ENTRY_POINTS, dict.fromkeys(JudgeName)).names()))


class VisionModel(Authored):
    """A model that looks at pictures, behind an OpenAI-compatible endpoint.

    Attributes:
        url: Base of the endpoint, up to `/v1`.
        model: As the endpoint calls it.
        api_key_env: Environment variable that holds the key; empty when the endpoint needs none.
        timeout_s: Longest wait for one answer, by the wall clock [s].
        max_questions: Criteria of one session that are asked about; the others are unknown.
    """

    url: str = pydantic.Field(pattern=r"^https?://\S+$")
    model: str = pydantic.Field(min_length=1)
    api_key_env: str = pydantic.Field(default="", pattern=r"^([A-Za-z_][A-Za-z0-9_]*)?$")
    timeout_s: float = pydantic.Field(default=20.0, gt=0)
    max_questions: int = pydantic.Field(default=8, ge=1)


class Verification(Authored):
    """How sessions are judged.

    Attributes:
        mode: What a judgement is for.
        judges: Asked in this order, shipped ones and those of installed packages; a costly one such as `vision` last,
            and only when nothing is false.
        criteria: Predicates that every session must meet beside its own acceptance (`metric(interventions) <= 0`).
        vision: The model that the judge `vision` asks.
        options: What a judge of an installed package is given, by its name.
    """

    mode: VerificationMode = VerificationMode.RECOVERY
    judges: tuple[
        Annotated[
            str,
            pydantic.Field(pattern=r"^[a-z][a-z0-9_]*$"),
            pydantic.AfterValidator(partial(admit, check=_require_judge)),
        ],
        ...,
    ] = pydantic.Field(default=DEFAULT_JUDGES, min_length=1)
    criteria: tuple[Annotated[str, pydantic.AfterValidator(partial(admit, check=parse_predicate))], ...] = ()
    vision: VisionModel | None = None
    options: dict[str, dict[str, JudgeOption]] = pydantic.Field(default_factory=dict)

    @pydantic.model_validator(mode="after")
    def _check_judges(self) -> Self:
        if JudgeName.VISION in self.judges and self.vision is None:
            raise ValueError("the judge 'vision' needs a block 'vision' with url and model")
        if self.criteria and JudgeName.METRICS not in self.judges:
            raise ValueError("'criteria' are judged by 'metrics', which is not among the judges")
        if strangers := sorted(set(self.options) - set(self.judges)):
            raise ValueError(f"options of {', '.join(strangers)}, which is not among the judges")
        return self
