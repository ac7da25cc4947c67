"""The understander that asks a language model, within limits; what it answers is checked as what the grammar makes.

The model gets one request and the vocabulary as JSON, and can give a goal, questions or what is missing, nothing else:
no tool, no limit and no approval is within its reach. Text of scenes is data in that JSON.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import pydantic

from phyagentos.agent.context.context import Section
from phyagentos.agent.context.dialogue import (
    LanguageModel,
    build_list,
    build_object,
    build_response_format,
    read_object,
)
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
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Authored
from phyagentos.protocol.predicates.library import get_predicate_library

_SYSTEM = " ".join(Path(__file__).with_name("model_instruction.txt").read_text(encoding="utf-8").split())


_Statements = Annotated[tuple[str, ...], pydantic.AfterValidator(lambda each: tuple(dict.fromkeys(each)))]


class ModelGoal(Authored):
    """The parts of a goal that a model may write; name, objective, scene and targets are not its own."""

    constraints: _Statements = ()
    steps: tuple[_Statements, ...] = ()
    accept: _Statements = pydantic.Field(min_length=1)


class ModelQuestion(Authored):
    """A question back; candidates are names of objects."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelUnderstander(LanguageModel):
    """Asks a model until its goal passes the checks, or the limits of one request are reached."""

    def understand(self, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> Understanding:
        """As `EmbeddedUnderstander.understand`."""
        found: Understanding | list[str] = self.converse(
            _describe(request, vocabulary, answers),
            _SYSTEM,
            build_answer_format(request, vocabulary),
            lambda text: _read(text, request, vocabulary, answers),
        )
        return refuse(RequestProblemKind.MODEL, *found) if isinstance(found, list) else found


def build_answer_format(request: str, vocabulary: Vocabulary) -> Fields:
    """The schema of `ModelAnswer` over a scene, whose statements and names a server can hold a model to."""
    statements, words, names = choose_statements(request, vocabulary), {"type": "string"}, sorted(vocabulary.objects)
    wanted = build_list(statements["wanted"], least=1)
    goal = {"accept": wanted, "steps": build_list(wanted), "constraints": build_list(statements["kept"])}
    question = {"words": words, "candidates": build_list({"enum": names}, least=2)}
    answers = {
        "goal": build_object(goal, "accept"),
        "questions": build_list(build_object(question, *question), least=1),
        "missing": build_list(words, least=1),
    }
    schema = {"type": "object", "anyOf": [build_object({name: form}, name) for name, form in answers.items()]}
    return build_response_format("understanding", schema)


def _describe(request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> tuple[Section, ...]:
    keys = ("kind", "colour", "movable", "has_interior", "opens", "part_of", "stands", "contents")
    question = {
        "request": request,
        "answered": dict(answers),
        "capabilities": sorted(vocabulary.capabilities),
        "postures": sorted(vocabulary.postures),
        "robot": f"`{ROLE}` stands for the robot, as in holding({ROLE}, thing)",
    }
    objects = vocabulary.objects.items()
    world = {name: {key: value for key in keys if (value := getattr(each, key))} for name, each in objects}
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
    answer = read_object(text, ModelAnswer)
    if isinstance(answer, list):
        return answer
    if answer.missing:
        return refuse(RequestProblemKind.CAPABILITY, *answer.missing)
    if answer.goal is not None:
        found = conclude(request, vocabulary, answer.goal.model_dump(), reasons=answer.reasons)
        if isinstance(found, Impossible):
            return [" ".join((each.kind, each.words, *each.nearest.split())) for each in found.lacks]
        is_grounded = names_anything(request, vocabulary)
        return find_disagreements(request, found.goal, vocabulary) or replace(found, is_grounded=is_grounded)
    named = (name for each in answer.questions for name in each.candidates)
    if strange := [f"no such thing: {name}" for name in named if name not in vocabulary.objects]:
        return strange
    if again := [f"answered already: {each.words}" for each in answer.questions if each.words in answers]:
        return again
    questions = (
        Question(kind=QuestionKind.WHICH, key=each.words, words=each.words, candidates=each.candidates)
        for each in answer.questions
    )
    return Ambiguous(questions=tuple(questions))
