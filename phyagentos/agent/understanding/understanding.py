"""What understanders of requests answer: a goal, questions or what is missing; and the checks that a goal has to pass.

What a model writes passes no easier than what the grammar makes: names, what objects are fit for, what skills bring
about, contradictions. Paper section 3.3.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import accumulate
from typing import Any, Self

from phyagentos.agent.goals.spec import NAME_MAX, WantedGoal
from phyagentos.agent.understanding.vocabulary import ROLE, Vocabulary, iter_literals
from phyagentos.errors import DefinitionError, find_nearest
from phyagentos.protocol.predicates import syntax
from phyagentos.protocol.predicates.library import ArgumentKind, Meaning, get_predicate_library
from phyagentos.protocol.predicates.meaning import find_definition, normalize, read_statement
from phyagentos.protocol.predicates.predicate import Predicate, parse_predicate

_Literal = tuple[bool, syntax.Call]  # whether it is to be true
_PLACES = {meaning for meaning in Meaning if meaning.names_place}
_DEMANDS = {  # what the object has to be, and then the place
    Meaning.INSIDE: ("movable", "has_interior"),
    Meaning.CONTAINS: ("has_interior",),
    **dict.fromkeys((Meaning.OPEN, Meaning.CLOSED), ("opens",)),
    **dict.fromkeys(
        (Meaning.ON, Meaning.AT, Meaning.NEAR, Meaning.UPRIGHT, Meaning.TURNED, Meaning.HOLDING), ("movable",)
    ),
}
_MOVERS = _DEMANDS.keys() - {Meaning.CONTAINS}  # what comes true by moving the object


class _Kind(StrEnum):
    """A kind, with what is printed of it before or after the words that it is about."""

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
    DEED = "deed", "What is to be done:"
    READING = "reading", "It can be read in several ways:"
    HOW_FAR = "how_far", "How far is"
    SIDE = "side", "Left, right, front and back depend on who looks; which one is"
    SPELLING = "spelling", "Is this meant by the word"
    VIEW = "view", "Left, right, front and back depend on who looks; who is it in"


class RequestProblemKind(_Kind):
    """Why a request cannot be met here."""

    WORD = "word", "is no word of this scene or of requests"
    SENTENCE = "sentence", "is not understood as a sentence"
    OBJECT = "thing", "is not here"
    UNLISTED = "unlisted", "is seen here and in no inventory, so that no goal can be about it"
    MEASURE = (
        "measure",
        "is no height, turn, opening or distance that a skill here guarantees: an object can be picked up, stood up, "
        "opened or closed, put onto another, or moved to a side by 5 cm or more",
    )
    FIT = "fit", "is not possible with this object"
    CAPABILITY = "capability", "is what no skill here brings about"
    CONTRADICTION = "contradiction", "cannot hold together"
    CONDITION = "condition", "is a condition that cannot be decided as the scene begins"
    UNMET = "unmet", "is not so as the scene begins, so there is nothing to do"
    FIXED = "fixed", "would move what is fixed"
    SOLID = "solid", "puts something into what has no inside"
    RIGID = "rigid", "opens or closes what has no joint"
    ROOM = "room", "asks for room: request it as a goal, and its plan says whether there is any"
    START = "start", "has to hold all through, and does not as the scene begins"
    PAST = "past", "means something done before, and nothing was"
    GOAL = "goal", "says nothing that shall come true"
    MATERIAL = "material", "is a material, of which nothing is known here: say the name, the colour or the size"
    WEIGHT = "weight", "is of a weight, which nothing here measures"
    SHAPE = "shape", "is an arrangement that no criterion describes: say a row, between two, beside or on another one"
    PART = "part", "is a part of a place that no criterion names: say the place, or a side of an object"
    MODEL = "model", "is what the model's answers came to"


OF_WORDS = frozenset(
    {RequestProblemKind.WORD, RequestProblemKind.SENTENCE}
)  # what a model may understand where the grammar does not
_UNFIT = {  # by the fact that an object lacks
    "movable": RequestProblemKind.FIXED,
    "has_interior": RequestProblemKind.SOLID,
    "opens": RequestProblemKind.RIGID,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """A question to ask back, about some words; any number may be answered where it has no candidates.

    An answer refers to the key: the words, and where in the request they begin. `likely` is the candidate that would be
    guessed, empty where none is likelier than others.
    """

    kind: QuestionKind
    key: str
    words: str
    candidates: tuple[str, ...] = ()
    likely: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestProblem:
    """What is missing: a word, name or predicate, the known one most like it, and what would be possible."""

    kind: RequestProblemKind
    words: str
    nearest: str = ""
    possible: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Understood:
    """A goal.

    Attributes:
        reasons: Which words became what; for people.
        left_out: Objects that the request names and the goal leaves as they are, each with the missing place.
        unsaid: Words without an effect on the goal, as `carefully`.
        chosen: Objects that stand for `a cube` or `two of the cubes`, where the choice was left open.
        is_grounded: Whether words of the request name what it is about; else it rests on a model alone.
    """

    goal: WantedGoal
    reasons: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    unsaid: tuple[str, ...] = ()
    chosen: tuple[str, ...] = ()
    is_grounded: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Ambiguous:
    """Questions that have to be answered first."""

    questions: tuple[Question, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Impossible:
    """What is missing here."""

    lacks: tuple[RequestProblem, ...]


class InquiryKind(StrEnum):
    """What a question wants to know."""

    WHETHER = "whether"
    """Whether all of some statements are true."""
    WHICH = "which"
    """Of which objects a statement is true."""
    COUNT = "count"
    """Of how many."""
    WHERE = "where"
    """In or on what objects are, and at which point."""
    SIDE = "side"
    """What is on a side of an object, as each one sees it who may look."""
    CONTENTS = "contents"
    """How many nameless objects are in vessels."""
    HEIGHT = "height"
    """How high an object is, written."""
    DISTANCE = "distance"
    """How far two objects are apart."""
    COMPARED = "compared"
    """Whether one of two objects is larger, nearer or the like: it, and which of the two is."""
    NEARER = "nearer"
    """To which of several objects another one is nearest."""
    FARTHER = "farther"
    COLOUR = "colour"
    WHY = "why"
    """Why the latest run failed."""
    ABILITIES = "abilities"
    """What can be wished for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Inquiry:
    """A question about the world: the objects it is about, each with the statement that decides, empty without one."""

    kind: InquiryKind
    words: str
    statements: Mapping[str, str] = field(default_factory=dict)


Understanding = Understood | Ambiguous | Impossible | Inquiry


def refuse(kind: RequestProblemKind, *words: str) -> Impossible:
    """What is missing, all of one kind."""
    return Impossible(lacks=tuple(RequestProblem(kind=kind, words=each) for each in words))


def conclude(request: str, vocabulary: Vocabulary, parts: Mapping[str, Any], **more: Any) -> Understood | Impossible:
    """The goal of a request with its constraints, steps and acceptance, unless it fails a check."""
    named = {"goal": name_goal(request), "scene": vocabulary.scene, "targets": {ROLE: vocabulary.robot}}
    goal = WantedGoal.model_validate({"objective": " ".join(request.split()), **named, **parts})
    lacks = find_lacks(goal, vocabulary)
    return Impossible(lacks=lacks) if lacks else Understood(goal=goal, **more)


def name_goal(request: str) -> str:
    """A name for the goal of a request: its first words."""
    names = accumulate(re.findall(r"[a-z0-9]+", request.lower()), "{}_{}".format)
    name = max((each for each in names if len(each) <= NAME_MAX // 2), key=len, default="")
    return name if re.match(r"[a-z]", name) else f"goal_{name}".strip("_")


def find_lacks(goal: WantedGoal, vocabulary: Vocabulary) -> tuple[RequestProblem, ...]:
    """Everything about a goal that cannot be met here; empty where it can be planned."""
    parsed: dict[str, Predicate] = {}
    lacks: list[RequestProblem] = []
    for text in (*goal.constraints, *(text for step in goal.steps for text in step), *goal.accept):
        try:
            parsed[text] = parse_predicate(text)
        except DefinitionError as error:
            lacks += [
                RequestProblem(kind=RequestProblemKind.SENTENCE, words=str(problem)) for problem in error.problems
            ]
    for text, predicate in parsed.items():
        lacks += _find_unknown(predicate, goal, vocabulary)
        if not lacks:
            calls = syntax.iter_calls(predicate.formula)
            lacks += [lack for call in calls for lack in find_unfit(call, vocabulary)]
        if text not in goal.constraints:
            lacks += find_incapable(predicate.formula, vocabulary)
    if lacks:
        return tuple(dict.fromkeys(lacks))
    constraints = [parsed[text].formula for text in goal.constraints]
    groups = [[parsed[text].formula for text in step] for step in (*goal.steps, goal.accept)]
    clashes = [pair for group in groups for pair in _iter_clashes(group, constraints)]
    return tuple(RequestProblem(kind=RequestProblemKind.CONTRADICTION, words=pair) for pair in dict.fromkeys(clashes))


def _find_unknown(predicate: Predicate, goal: WantedGoal, vocabulary: Vocabulary) -> Iterator[RequestProblem]:
    for reference in predicate.iter_references():
        is_target = reference.kind is ArgumentKind.TARGET
        known = (*goal.targets, *vocabulary.targets, "target", ROLE) if is_target else tuple(vocabulary.objects)
        if reference.name not in known:
            near = find_nearest(reference.name, known) or ""
            yield RequestProblem(kind=RequestProblemKind.OBJECT, words=reference.name, nearest=near, possible=known)


def find_unfit(call: syntax.Call, vocabulary: Vocabulary) -> Iterator[RequestProblem]:
    """Objects of a predicate that cannot be used so, with those that can."""
    said = read_statement(call)
    demands = _DEMANDS.get(said.meaning, ()) if said.meaning is not None else ()
    for term, fact in zip((said.object, said.place), demands, strict=False):
        if isinstance(term, syntax.Name) and not getattr(vocabulary.objects[term.text], fact):
            possible = tuple(name for name, item in vocabulary.objects.items() if getattr(item, fact))
            yield RequestProblem(kind=_UNFIT[fact], words=syntax.render(call), possible=possible)
    names = [term.text for term in call.terms if isinstance(term, syntax.Name)]
    if len(names) != len(set(names)):
        yield RequestProblem(kind=RequestProblemKind.CONTRADICTION, words=syntax.render(call))
    most = sum(item.contents for item in vocabulary.objects.values())
    if said.meaning is Meaning.CONTAINS and said.number is not None and said.number > most:
        yield RequestProblem(kind=RequestProblemKind.FIT, words=syntax.render(call), possible=(str(most),))


def find_incapable(formula: syntax.Formula, vocabulary: Vocabulary) -> Iterator[RequestProblem]:
    """Literals that no skill brings about. To end a place is to bring the object to another."""
    able = vocabulary.capabilities
    places = {each.name for each in get_predicate_library() if each.meaning in _PLACES}
    for is_true, call in ((is_true, normalize(call)) for is_true, call in iter_literals(formula)):
        name, meaning = call.name if is_true else f"not {call.name}", read_statement(call).meaning
        is_ended = not is_true and call.name in places and not places.isdisjoint(able)
        is_flipped = not is_true and any(each in able for each in list_opposites(call))
        stays = not is_true and meaning is Meaning.MOVED
        if name not in able and not is_ended and not is_flipped and not stays:
            yield RequestProblem(kind=RequestProblemKind.CAPABILITY, words=name, possible=tuple(able))


def _iter_clashes(group: Sequence[syntax.Formula], constraints: Sequence[syntax.Formula]) -> Iterator[str]:
    wanted, always = (  # of a disjunction no part need hold
        [literal for formula in formulas if not isinstance(formula, syntax.Or) for literal in iter_literals(formula)]
        for formulas in (group, constraints)
    )
    for index, one in enumerate(wanted):
        for other in (*wanted[index + 1 :], *always):
            if _excludes(one, other) or _excludes(other, one):
                pair = (call if is_true else syntax.Not(call) for is_true, call in (one, other))
                yield " and ".join(map(syntax.render, pair))


def _excludes(one: _Literal, other: _Literal) -> bool:
    """Whether two conditions exclude each other, as far as their names alone say."""
    (is_true, call), (is_other_true, second) = ((value, normalize(call)) for value, call in (one, other))
    said, other_said = read_statement(call), read_statement(second)
    is_place = said.meaning in _PLACES
    if call == second:
        return is_true is not is_other_true
    if isinstance(said.object, syntax.Star) and said.meaning is other_said.meaning in _PLACES:
        return not is_true and is_other_true and said.place == other_said.place
    if said.meaning is other_said.meaning is Meaning.ON and call.terms == second.terms[::-1]:
        return is_true and is_other_true
    if said.object == other_said.object and is_true and is_other_true and said.meaning is not Meaning.HOLDING:
        return second.name in list_opposites(call) or (call.name == second.name and is_place)
    keeps = other_said.meaning is Meaning.MOVED and not is_other_true
    moves = said.meaning in _MOVERS and (is_true or is_place)
    return keeps and moves and said.object == other_said.object


def list_opposites(call: syntax.Call) -> tuple[str, ...]:
    """Predicates that are false of its object where it is true."""
    definition = find_definition(call)
    return definition.excludes if definition is not None else ()
