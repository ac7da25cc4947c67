"""The port of understanders, and what they answer: a goal, questions, or what is missing. Paper section 3.3."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.understanding.vocabulary import Vocabulary


class QuestionKind(StrEnum):
    """What a request leaves open."""

    WHICH = "which"
    """One thing is meant, and several fit."""
    WHERE = "where"
    """A place is meant for each of several things, and which for which is not said."""
    HOW_MANY = "how_many"
    """An amount is not said."""
    ORDER = "order"
    """What comes on what is not said."""
    READING = "reading"
    """The sentence can be read in several ways, which differ as goals."""


class LackKind(StrEnum):
    """Why a request cannot be met here."""

    WORD = "word"
    """A word is neither of the language of requests nor of this scene."""
    SENTENCE = "sentence"
    """Each word is known, the sentence is not."""
    THING = "thing"
    """Nothing here is called so, or not so many."""
    FIT = "fit"
    """The thing is there, and cannot be used so: it is fixed, has no interior, or no joint."""
    CAPABILITY = "capability"
    """No skill guarantees it."""
    CONTRADICTION = "contradiction"
    """Two parts of the request cannot both hold."""
    PAST = "past"
    """Nothing was done before that could be meant."""
    GOAL = "goal"
    """It says what must not happen, and nothing that shall."""
    MODEL = "model"
    """The model gave no goal that passes the checks, within its limits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """One thing to ask back.

    Attributes:
        key: What an answer refers to: the words, and where they begin.
        words: The words of the request that it is about.
        candidates: What may be answered; empty where any number may.
    """

    kind: QuestionKind
    key: str
    words: str
    candidates: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Lack:
    """One thing that is missing.

    Attributes:
        words: The word, the name or the predicate that it is about.
        nearest: The known name most like it; empty where none is.
        possible: What would be possible instead.
    """

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


class Understander(Protocol):
    """Makes a goal of a request."""

    def understand(self, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> Understanding:
        """The goal of a request, or why there is none.

        Args:
            request: One or more sentences.
            vocabulary: All that the request can be about.
            answers: Key of a question -> the candidate that was chosen.
        """
