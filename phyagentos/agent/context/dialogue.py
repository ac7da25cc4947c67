"""A language model that is put one question within limits; what it is shown and what it answers are kept.

Problems of its answer go back to it, at most as often as the limits allow. Answers can be kept in a file, and used
again in its place.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeVar

import msgspec
import pydantic

from phyagentos.agent.context.context import Section, build_context
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.network.chat import Completion
from phyagentos.protocol.documents.plain_data import Fields

LETTERS_A_TOKEN = 3  # fewer than any tokenizer needs for English and JSON, so that an estimate is not too low
ANSWER_TOKENS = 1500
PROBLEMS_MAX = 8  # of one answer
ITEMS_MAX = 8  # of each list of one answer, so that a model that repeats itself comes to an end
_ReadT = TypeVar("_ReadT")
_ModelT = TypeVar("_ModelT", bound=pydantic.BaseModel)


class AnswerFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The answers to one request over one scene, in their order, and what the model was shown; it holds no key."""

    request: str
    scene: str
    model: str
    answers: tuple[Completion, ...]
    shown: dict[str, str] = {}
    version: Literal[1] = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class LanguageModel:
    """Asks a model until its answer passes the checks, or the limits of one question are reached.

    Attributes:
        complete: As `OpenAiEndpoint.complete`.
        rounds: Answers at most, the corrected ones included.
        time_s: Of all answers, by the wall clock [s].
        tokens: Of all questions and answers.
        price: Of a million tokens, in any currency.
        cost: Of all, in the same currency; bounds nothing where the price is 0.
        kept: Every answer, in order.
        shown: Every context that the model was shown, by its SHA-256.
    """

    name: str
    complete: Callable[..., Completion]
    clock: Clock
    rounds: int = 3
    time_s: float = 60.0
    tokens: int = 24_000
    price: float = 0.0
    cost: float = 0.0
    kept: list[Completion] = field(default_factory=list)
    shown: dict[str, str] = field(default_factory=dict)

    def converse(
        self,
        sections: Iterable[Section],
        instruction: str,
        form: Fields,
        read: Callable[[str], _ReadT | list[str]],
    ) -> _ReadT | list[str]:
        """What `read` makes of an answer to these sections of a context, or the problems of the last one.

        `form` is the response format, to which not every server keeps.
        """
        tokens = min(self.tokens, int(1e6 * self.cost / self.price)) if self.price > 0.0 else self.tokens
        try:
            context = build_context("plan", sections, tokens)
        except DefinitionError as error:  # the question alone is longer than the limits allow
            return [str(error)]
        self.shown[context.sha256] = context.text
        messages = [{"role": "system", "content": instruction}, {"role": "user", "content": context.text}]
        started_s, spent, problems = self.clock.now_s(), 0, ["no answer within the limits"]
        for _ in range(self.rounds):
            shown_tokens = sum(len(message["content"]) for message in messages) // LETTERS_A_TOKEN
            room = min(ANSWER_TOKENS, tokens - spent - shown_tokens)
            left_s = self.time_s - (self.clock.now_s() - started_s)
            if room <= 0 or left_s <= 0.0:
                problems.append(f"stopped at {spent} tokens, {self.time_s - left_s:.0f} s")
                break
            try:
                found = self.complete(messages, max_tokens=room, response_format=form, timeout_s=left_s)
            except ExecutionError as error:
                return [str(error)]
            self.kept.append(found)
            spent += found.tokens or shown_tokens + len(found.text) // LETTERS_A_TOKEN + 1
            answer = read(found.text)
            if not isinstance(answer, list):
                return answer
            problems = answer[:PROBLEMS_MAX]
            correction = msgspec.json.encode({"problems": problems, "task": "Answer again, corrected."}).decode()
            messages += [{"role": "assistant", "content": found.text}, {"role": "user", "content": correction}]
        return problems


def build_response_format(name: str, schema: Fields) -> Fields:
    """A form of answers, as OpenAI-compatible servers take it."""
    return {"type": "json_schema", "json_schema": {"name": name, "schema": schema, "strict": False}}


def build_object(properties: Fields, *required: str) -> Fields:
    """The schema of an object without other fields."""
    return {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}


def build_list(items: Fields, least: int = 0, most: int = ITEMS_MAX) -> Fields:
    """The schema of a list."""
    return {"type": "array", "items": items, "minItems": least, "maxItems": most}


def read_object(text: str, model: type[_ModelT]) -> _ModelT | list[str]:
    """The one object of an answer, or its problems."""
    start, end = text.find("{"), text.rfind("}")  # prose around the object is no part of it
    try:
        return model.model_validate_json(text[start : end + 1])
    except pydantic.ValidationError as error:
        return [f"{'.'.join(map(str, each['loc'])) or 'answer'}: {each['msg']}" for each in error.errors()]


def write_answers(path: Path, request: str, scene: str, model: LanguageModel) -> None:
    """Keep the answers of a model, and the contexts that it was shown."""
    data = msgspec.json.encode(AnswerFile(request, scene, model.name, tuple(model.kept), model.shown))
    path.write_bytes(msgspec.json.format(data, indent=2) + b"\n")


def replay_answers(path: Path, request: str, scene: str) -> Callable[..., Completion]:
    """A model that gives the answers of a file in their order; raises DefinitionError where that has no fitting one."""
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
