"""Answers of a model, kept in a file beside the goal graph, and used again in the place of the model."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import msgspec

from phyagentos.errors import DefinitionError
from phyagentos.network.chat import Completion


class AnswerFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The answers to one request over one scene, in their order, and what the model was shown; it holds no key."""

    request: str
    scene: str
    model: str
    answers: tuple[Completion, ...]
    shown: dict[str, str] = {}
    version: Literal[1] = 1


def write_answers(
    path: Path, request: str, scene: str, model: str, answers: Sequence[Completion], shown: Mapping[str, str]
) -> None:
    """Keep the answers of a model, and the contexts that it was shown, by their SHA-256."""
    data = msgspec.json.encode(AnswerFile(request, scene, model, tuple(answers), dict(shown)))
    path.write_bytes(msgspec.json.format(data, indent=2) + b"\n")


def replay_answers(path: Path, request: str, scene: str) -> Callable[..., Completion]:
    """A model that gives the answers of a file in their order; they pass the same checks as those of any.

    Raises:
        DefinitionError: It is no such file, or of another request or scene; also when it is asked for one more answer.
    """
    try:
        kept = msgspec.json.decode(path.read_bytes(), type=AnswerFile)
    except msgspec.MsgspecError as error:
        wanted = "answers as `paos ask` keeps them"
        raise DefinitionError.of("INVALID_VALUE", str(path), str(error), wanted) from error
    if (kept.request, kept.scene) != (request, scene):
        found, wanted = f"answers to {kept.request!r} in {kept.scene}", f"{request!r} in {scene}"
        raise DefinitionError.of("INVALID_VALUE", str(path), found, wanted, "Ask a model again.")
    answers = iter(kept.answers)

    def complete(*_: object, **__: object) -> Completion:
        if (answer := next(answers, None)) is None:
            hint = "Skills, scene or answers to questions differ from then: ask a model again."
            raise DefinitionError.of("INVALID_VALUE", str(path), "no further answer", "one more", hint)
        return answer

    return complete
