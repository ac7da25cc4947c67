"""Answers of people to criteria `human: QUESTION`: a file each, in the bundle of a session or beside a goal's graph.

As with what a model was shown, an answer may come after a bundle is sealed; a judgement names it by its hash.
"""

import hashlib
from collections.abc import Iterable
from pathlib import Path

import msgspec

from phyagentos.protocol.documents.durable_files import create_durably
from phyagentos.protocol.predicates.predicate import find_question
from phyagentos.protocol.sessions.evidence_manifest import read_part
from phyagentos.protocol.world.truth import Truth
from phyagentos.wording import format_time

ANSWERS = "answers/"


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """What a person answered.

    Attributes:
        question: As in the criterion.
        truth: Of the criterion: `true` for yes, `false` for no.
        by: Who answered.
        at: UTC wall time.
    """

    question: str
    truth: Truth
    by: str
    at: str

    def __str__(self) -> str:
        return f"{'yes' if self.truth is Truth.TRUE else 'no'}, answered by {self.by} at {format_time(self.at)}"


def get_answer_name(question: str) -> str:
    """Name of the answer to a question in its folder."""
    return f"{ANSWERS}{hashlib.sha256(question.encode()).hexdigest()[:16]}.json"


def read_answer(folder: Path, question: str) -> Answer | None:
    """The answer to a question; None before there is one. Raises ExecutionError `EVIDENCE_DAMAGED`."""
    return read_part(folder / get_answer_name(question), Answer)


def keep_answer(folder: Path, answer: Answer) -> bool:
    """Record an answer durably; whether there was none to this question. Raises OSError."""
    return create_durably(folder / get_answer_name(answer.question), msgspec.json.encode(answer) + b"\n")


def find_open(folder: Path, texts: Iterable[str]) -> tuple[str, ...]:
    """The questions among criteria that wait for an answer, in their order."""
    questions = filter(None, map(find_question, texts))
    return tuple(each for each in questions if not (folder / get_answer_name(each)).exists())
