"""The verifier of a workspace, as its runtime_contract.yaml asks for it; the only place that makes one with a key."""

import os
from collections.abc import Sequence

from phyagentos.agent.judges.holds import HoldJudge
from phyagentos.agent.judges.judge import Judge
from phyagentos.agent.judges.lookahead import LookaheadJudge
from phyagentos.agent.judges.metrics import MetricJudge
from phyagentos.agent.judges.predicates import PredicateJudge
from phyagentos.agent.judges.vision import VisionJudge
from phyagentos.agent.judges.vision_endpoint import OpenAiEndpoint
from phyagentos.agent.verifier import SessionVerifier
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.runtime_contract import read_runtime_contract
from phyagentos.protocol.verdicts import JudgeName, VerificationMode
from phyagentos.protocol.verification import Verification, VisionModel
from phyagentos.protocol.workspace import Workspace


def build_verifier(
    workspace: Workspace,
    clock: Clock,
    *,
    mode: VerificationMode | None = None,
    judges: Sequence[JudgeName] | None = None,
) -> SessionVerifier:
    """The verifier that the workspace's settings describe.

    Args:
        workspace: With runtime_contract.yaml; without one, the defaults hold, which are the strictest.
        clock: Bounds the wait for a model.
        mode: Instead of the one in the settings.
        judges: Instead of those in the settings.

    Raises:
        DefinitionError: With every problem of the file; `VISION_NOT_CONFIGURED`, `API_KEY_MISSING`.
    """
    file = workspace.runtime_contract
    settings = read_runtime_contract(file).verification if file.exists() else Verification()
    names = tuple(dict.fromkeys(settings.judges if judges is None else judges))
    free = [_build_judge(name, settings) for name in names if name is not JudgeName.VISION]
    costly = [_build_vision(settings.vision, workspace, clock)] if JudgeName.VISION in names else []
    return SessionVerifier(judges=free, costly=costly, mode=settings.mode if mode is None else mode)


def _build_judge(name: JudgeName, settings: Verification) -> Judge:
    match name:
        case JudgeName.HOLDS:
            return HoldJudge()
        case JudgeName.METRICS:
            return MetricJudge(settings.criteria)
        case JudgeName.LOOKAHEAD:
            return LookaheadJudge()
        case _:
            return PredicateJudge()


def _build_vision(model: VisionModel | None, workspace: Workspace, clock: Clock) -> VisionJudge:
    address = f"{workspace.runtime_contract}: verification"
    if model is None:
        hint = "Write 'vision: {url: ..., model: ...}' below 'verification'; until then nobody is asked."
        raise DefinitionError(
            Problem(
                code="VISION_NOT_CONFIGURED", address=address, found="no block 'vision'", expected="a model", hint=hint
            )
        )
    key = os.environ.get(model.api_key_env, "") if model.api_key_env else ""
    if model.api_key_env and not key:
        raise DefinitionError(
            Problem(
                code="API_KEY_MISSING",
                address=f"{address}.vision.api_key_env",
                found=f"environment variable {model.api_key_env} is not set",
                expected="the key of the endpoint",
                hint=f"Set {model.api_key_env}, or leave 'api_key_env' out when the endpoint wants no key.",
            )
        )
    endpoint = OpenAiEndpoint(url=model.url, model=model.model, clock=clock, key=key, timeout_s=model.timeout_s)
    return VisionJudge(endpoint, model.max_questions)
