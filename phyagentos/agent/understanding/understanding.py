"""What understanders of requests answer: a goal, questions, or what is missing. Paper section 3.3."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Self

from phyagentos.agent.goals.wanted import WantedGoal


class _Kind(StrEnum):
    """A kind, with what a person is told of it before or after the words that it is about."""

    told: str

    def __new__(cls, value: str, told: str) -> Self:
        kind = str.__new__(cls, value)
        kind._value_, kind.told = value, told
        return kind


class QuestionKind(_Kind):
    """What a request leaves open."""

    WHICH = "which", "Several fit; which one is"
    WHERE = "where", "Which place is meant by"
    HOW_MANY = "how_many", "How many, or which, are"
    ORDER = "order", "In which order, from below, is"
    READING = "reading", "It can be read in several ways:"


class LackKind(_Kind):
    """Why a request cannot be met here."""

    WORD = "word", "is no word of this scene or of requests"
    SENTENCE = "sentence", "is not understood as a sentence"
    THING = "thing", "is not here"
    FIT = "fit", "is not possible with this thing"
    CAPABILITY = "capability", "is what no skill here brings about"
    CONTRADICTION = "contradiction", "cannot hold together"
    PAST = "past", "means something done before, and nothing was"
    GOAL = "goal", "says nothing that shall come true"
    MODEL = "model", "is what the model's answers came to"


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """One thing to ask back, about some words of the request; any number may be answered where it has no candidates.

    Attributes:
        key: What an answer refers to: the words, and where they begin.
    """

    kind: QuestionKind
    key: str
    words: str
    candidates: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Lack:
    """One thing that is missing: a word, name or predicate, the known one most like it, and what would be possible."""

    kind: LackKind
    words: str
    nearest: str = ""
    possible: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Understood:
    """A goal.

    Attributes:
        reasons: Which words became what; for people.
        left_out: Things that the request names and the goal leaves as they are, each with the missing place.
        unsaid: Words without an effect on the goal, as `carefully`.
        chosen: Things that stand for `a cube` or `two of the cubes`, where the choice was left open.
    """

    goal: WantedGoal
    reasons: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    unsaid: tuple[str, ...] = ()
    chosen: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Ambiguous:
    """Questions that have to be answered first."""

    questions: tuple[Question, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Impossible:
    """What is missing here."""

    lacks: tuple[Lack, ...]


Understanding = Understood | Ambiguous | Impossible
