"""The understander that asks a language model, within limits; what it answers is checked as what the grammar makes.

The model gets one request and the vocabulary as JSON, and can give a goal, questions or what is missing, nothing else:
no tool, no limit and no approval is within its reach. Text of scenes is data in that JSON. Problems of its answer go
back to it, at most as often as the limits allow. Its answers can be kept in a file, and used again in its place.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import pydantic

from phyagentos.agent.context.context import Section, build_context
from phyagentos.agent.understanding.grounding import choose_statements, find_disagreements, names_anything
from phyagentos.agent.understanding.understanding import (
    Ambiguous,
    Impossible,
    Question,
    QuestionKind,
    RequestProblemKind,
    Understanding,
    conclude,
    refuse,
)
from phyagentos.agent.understanding.vocabulary import ROLE, Vocabulary
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.network.chat import Completion
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Authored
from phyagentos.protocol.predicates.library import get_predicate_library

LETTERS_A_TOKEN = 3  # fewer than any tokenizer needs for English and JSON, so that an estimate is not too low
ANSWER_TOKENS = 1500
PROBLEMS_MAX = 8  # of one answer
ITEMS_MAX = 8  # of each list of one answer, so that a model that repeats itself comes to an end
_SYSTEM = " ".join(Path(__file__).with_name("model_instruction.txt").read_text(encoding="utf-8").split())


_Statements = Annotated[tuple[str, ...], pydantic.AfterValidator(lambda each: tuple(dict.fromkeys(each)))]


class ModelGoal(Authored):
    """The parts of a goal that a model may write; name, objective, scene and targets are not its own."""

    constraints: _Statements = ()
    steps: tuple[_Statements, ...] = ()
    accept: _Statements = pydantic.Field(min_length=1)


class ModelQuestion(Authored):
    """A question back; candidates are names of things."""

    words: str
    candidates: tuple[str, ...] = pydantic.Field(min_length=2)


class ModelAnswer(Authored):
    """The one object that a model answers with."""

    goal: ModelGoal | None = None
    questions: tuple[ModelQuestion, ...] = ()
    missing: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()

    @pydantic.model_validator(mode="after")
    def _check_one(self) -> "ModelAnswer":
        if sum(map(bool, (self.goal, self.questions, self.missing))) != 1:
            raise ValueError("exactly one of goal, questions and missing")
        return self


class AnswerFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The answers to one request over one scene, in their order, and what the model was shown; it holds no key."""

    request: str
    scene: str
    model: str
    answers: tuple[Completion, ...]
    shown: dict[str, str] = {}
    version: Literal[1] = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelUnderstander:
    """Asks a model until its goal passes the checks, or the limits of one request are reached.

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

    def understand(self, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> Understanding:
        """As `EmbeddedUnderstander.understand`."""
        tokens = min(self.tokens, int(1e6 * self.cost / self.price)) if self.price > 0.0 else self.tokens
        try:
            context = build_context("plan", _describe(request, vocabulary, answers), tokens)
        except DefinitionError as error:  # the request alone is longer than the limits allow
            return refuse(RequestProblemKind.MODEL, str(error))
        self.shown[context.sha256] = context.text
        messages = [{"role": "system", "content": _SYSTEM}, {"role": "user", "content": context.text}]
        form = build_response_format(request, vocabulary)
        started_s, spent, problems = self.clock.now_s(), 0, ["no answer within the limits"]
        for _ in range(self.rounds):
            asked = sum(len(message["content"]) for message in messages) // LETTERS_A_TOKEN
            room = min(ANSWER_TOKENS, tokens - spent - asked)
            left_s = self.time_s - (self.clock.now_s() - started_s)
            if room <= 0 or left_s <= 0.0:
                problems.append(f"stopped at {spent} tokens, {self.time_s - left_s:.0f} s")
                break
            try:
                found = self.complete(messages, max_tokens=room, response_format=form, timeout_s=left_s)
            except ExecutionError as error:
                return refuse(RequestProblemKind.MODEL, str(error))
            self.kept.append(found)
            spent += found.tokens or asked + len(found.text) // LETTERS_A_TOKEN + 1
            understood = _read(found.text, request, vocabulary, answers)
            if not isinstance(understood, list):
                return understood
            problems = understood[:PROBLEMS_MAX]
            correction = msgspec.json.encode({"problems": problems, "task": "Answer again, corrected."}).decode()
            messages += [{"role": "assistant", "content": found.text}, {"role": "user", "content": correction}]
        return refuse(RequestProblemKind.MODEL, *problems)


def build_response_format(request: str, vocabulary: Vocabulary) -> Fields:
    """The schema of `ModelAnswer` over a scene, whose statements and names a server can hold a model to."""
    statements, words, names = choose_statements(request, vocabulary), {"type": "string"}, sorted(vocabulary.things)
    wanted = _build_list(statements["wanted"], least=1)
    goal = {"accept": wanted, "steps": _build_list(wanted), "constraints": _build_list(statements["kept"])}
    question = {"words": words, "candidates": _build_list({"enum": names}, least=2)}
    answers = {
        "goal": _build_object(goal, "accept"),
        "questions": _build_list(_build_object(question, *question), least=1),
        "missing": _build_list(words, least=1),
    }
    schema = {"type": "object", "anyOf": [_build_object({name: form}, name) for name, form in answers.items()]}
    return {"type": "json_schema", "json_schema": {"name": "understanding", "schema": schema, "strict": False}}


def _build_object(properties: Fields, *required: str) -> Fields:
    return {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}


def _build_list(items: Fields, least: int = 0) -> Fields:
    return {"type": "array", "items": items, "minItems": least, "maxItems": ITEMS_MAX}


def write_answers(path: Path, request: str, scene: str, model: ModelUnderstander) -> None:
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


def _describe(request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> tuple[Section, ...]:
    keys = ("kind", "colour", "movable", "has_interior", "opens", "part_of", "stands", "contents")
    question = {
        "request": request,
        "answered": dict(answers),
        "capabilities": sorted(vocabulary.capabilities),
        "postures": sorted(vocabulary.postures),
        "robot": f"`{ROLE}` stands for the robot, as in holding({ROLE}, thing)",
    }
    things = vocabulary.things.items()
    world = {name: {key: value for key in keys if (value := getattr(each, key))} for name, each in things}
    parts = {"objective", "constraints", "steps", "accept"}
    before = {goal.goal: goal.model_dump(include=parts) for goal in vocabulary.past[-3:]}
    return (
        Section("question", question),
        Section("predicates", {each.signature: each.description for each in get_predicate_library()}),
        Section("world", world),
        Section("knowledge", before),
    )


def _read(text: str, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> Understanding | list[str]:
    """What an answer means, or its problems."""
    start, end = text.find("{"), text.rfind("}")  # prose around the object is no part of it
    try:
        answer = ModelAnswer.model_validate_json(text[start : end + 1])
    except pydantic.ValidationError as error:
        return [f"{'.'.join(map(str, each['loc'])) or 'answer'}: {each['msg']}" for each in error.errors()]
    if answer.missing:
        return refuse(RequestProblemKind.CAPABILITY, *answer.missing)
    if answer.goal is not None:
        found = conclude(request, vocabulary, answer.goal.model_dump(), reasons=answer.reasons)
        if isinstance(found, Impossible):
            return [" ".join((each.kind, each.words, *each.nearest.split())) for each in found.lacks]
        is_grounded = names_anything(request, vocabulary)
        return find_disagreements(request, found.goal, vocabulary) or replace(found, is_grounded=is_grounded)
    named = (name for each in answer.questions for name in each.candidates)
    if strange := [f"no such thing: {name}" for name in named if name not in vocabulary.things]:
        return strange
    if again := [f"answered already: {each.words}" for each in answer.questions if each.words in answers]:
        return again
    questions = (
        Question(kind=QuestionKind.WHICH, key=each.words, words=each.words, candidates=each.candidates)
        for each in answer.questions
    )
    return Ambiguous(questions=tuple(questions))
