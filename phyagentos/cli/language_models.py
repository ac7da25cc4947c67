"""Options of commands that may ask a language model, and the model that the environment names."""

import os
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from phyagentos.agent.context.dialogue import LanguageModel, replay_answers
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.network.chat import OpenAiEndpoint
from phyagentos.protocol.documents.plain_data import Fields

MODEL_URL, MODEL, MODEL_KEY = "PHYAGENTOS_MODEL_URL", "PHYAGENTOS_MODEL", "PHYAGENTOS_MODEL_KEY"
ModelAnswers = Annotated[Path | None, typer.Option(help="Use these answers of a model, and ask none.")]
ModelTime = Annotated[float, typer.Option(help="Longest wait for a model, all answers together [s].")]
ModelTokens = Annotated[int, typer.Option(help="Most tokens of all questions and answers.")]
ModelPrice = Annotated[float, typer.Option(help="Price of a million tokens.")]
ModelCost = Annotated[float, typer.Option(help="Most that a request may cost, at that price.")]
_ModelT = TypeVar("_ModelT", bound=LanguageModel)


def open_model(kind: type[_ModelT], answers: Path | None, request: str, scene: str, limits: Fields) -> _ModelT | None:
    """Recorded answers, else the endpoint that the environment names; else none."""
    if answers is not None:
        complete, name = replay_answers(answers, request, scene), str(answers)
    elif url := os.environ.get(MODEL_URL, ""):
        if not (model := os.environ.get(MODEL, "")):
            raise DefinitionError.of("INVALID_VALUE", MODEL, "not set", f"the name of a model at {MODEL_URL}")
        endpoint = OpenAiEndpoint(url=url, model=model, key=os.environ.get(MODEL_KEY, ""))
        complete, name = endpoint.complete, endpoint.name
    else:
        return None
    return kind(name=name, complete=complete, clock=SystemClock(), **limits)
