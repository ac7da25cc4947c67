"""The judges that can be asked, and the verifier of a workspace; the only place that makes one with a key."""

import os
from collections.abc import Sequence

from phyagentos.agent.judging.judges.judge_registry import (
    ForeignJudge,
    Judge,
    JudgeDefinition,
    JudgeSettings,
    choose_judges,
)
from phyagentos.agent.judging.judges.metrics import HoldJudge, MetricJudge
from phyagentos.agent.judging.judges.predicates import LookaheadJudge, PredicateJudge
from phyagentos.agent.judging.judges.vision import VisionJudge
from phyagentos.agent.judging.verifier import SessionVerifier
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError
from phyagentos.network.chat import OpenAiEndpoint
from phyagentos.plugins import Plugins
from phyagentos.protocol.settings.runtime_contract import read_runtime_contract
from phyagentos.protocol.settings.verification import JUDGE_ENTRY_POINTS, JudgeName, Verification
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.workspace import Workspace


def build_verifier(
    workspace: Workspace, clock: Clock, *, mode: VerificationMode | None = None, judges: Sequence[str] | None = None
) -> SessionVerifier:
    """The verifier that the workspace's settings describe; without runtime_contract.yaml the strictest defaults hold.

    `mode` and `judges` (named as by `--with`) replace those of the settings.

    Raises:
        DefinitionError: With every problem of the file; `UNKNOWN_NAME`, `EXTRA_MISSING`.
    """
    file = workspace.runtime_contract
    settings = read_runtime_contract(file).verification if file.exists() else Verification()
    address = f"{file}: verification"
    names, place = (settings.judges, f"{address}.judges") if judges is None else (judges, "--with")
    free: list[Judge] = []
    costly: list[Judge] = []
    for definition in choose_judges(JUDGES, names, place):
        options = settings.options.get(definition.name, {})
        how = JudgeSettings(verification=settings, clock=clock, options=options, address=address)
        is_shipped = definition.name in JUDGES.shipped
        judge = definition.open(how) if is_shipped else ForeignJudge.open(definition, how)
        (costly if definition.is_costly else free).append(judge)
    return SessionVerifier(judges=free, costly=costly, mode=settings.mode if mode is None else mode)


def _open_vision(settings: JudgeSettings) -> VisionJudge:
    model = settings.verification.vision
    if model is None:
        hint = "Write 'vision: {url: ..., model: ...}' below 'verification'; until then no model is asked."
        raise DefinitionError.of("EXTRA_MISSING", settings.address, "no block 'vision'", "a model", hint)
    key = os.environ.get(model.api_key_env, "") if model.api_key_env else ""
    if model.api_key_env and not key:
        address = f"{settings.address}.vision.api_key_env"
        found = f"environment variable {model.api_key_env} is not set"
        hint = f"Set {model.api_key_env}, or leave 'api_key_env' out when the endpoint needs no key."
        raise DefinitionError.of("EXTRA_MISSING", address, found, "the key of the endpoint", hint)
    endpoint = OpenAiEndpoint(url=model.url, model=model.model, key=key, timeout_s=model.timeout_s)
    return VisionJudge(endpoint, model.max_questions)


JUDGES = Plugins[JudgeDefinition](
    JUDGE_ENTRY_POINTS,
    {
        each.name: each
        for each in (
            JudgeDefinition(
                name=JudgeName.PREDICATES,
                open=lambda _: PredicateJudge(),
                description="Acceptance, on the snapshots before and after.",
            ),
            JudgeDefinition(
                name=JudgeName.HOLDS,
                open=lambda _: HoldJudge(),
                description="What had to hold all through, on the worst samples.",
            ),
            JudgeDefinition(
                name=JudgeName.METRICS,
                open=lambda settings: MetricJudge(settings.verification.criteria),
                description="Numbers that were measured on the way.",
            ),
            JudgeDefinition(
                name=JudgeName.LOOKAHEAD,
                open=lambda _: LookaheadJudge(),
                description="The chance that was simulated before; it advises.",
            ),
            JudgeDefinition(
                name=JudgeName.VISION,
                open=_open_vision,
                is_costly=True,
                description="A model that is shown the camera frames before and after.",
            ),
        )
    },
    kind=JudgeDefinition,
    noun="judge",
)
"""What ships, and what installed packages announce."""
