"""What a goal can say over a scene, for a model that must choose, and whether a goal agrees with the request's words.

Upstream: the vocabulary. Downstream: the understander that asks a model.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.understanding.phrases import NUMBERS
from phyagentos.agent.understanding.reading import pluralise
from phyagentos.agent.understanding.understanding import find_incapable, find_unfit
from phyagentos.agent.understanding.vocabulary import REGION, ROLE, Vocabulary, read_lexicon
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates import syntax
from phyagentos.protocol.predicates.library import ArgumentKind, Meaning, PredicateDefinition, get_predicate_library
from phyagentos.protocol.predicates.meaning import read_statement
from phyagentos.protocol.predicates.predicate import find_entities, parse_predicate

STATEMENTS_MAX = 400  # in a schema; more are left to the checks of the answer
_ENDED = {Meaning.INSIDE, Meaning.ON}  # what is ended by bringing the object elsewhere
_KEPT = {Meaning.UPRIGHT: "{}", Meaning.MOVED: "not {}"}  # what may have to hold all through


def choose_statements(request: str, vocabulary: Vocabulary) -> dict[str, Fields]:
    """JSON schemas of a wanted statement and of a constraint over a scene.

    Each lists what can be chosen: of the objects that the request names those statements that are about all of them,
    where there are any. No list foresees a number in a request, or is longer than `STATEMENTS_MAX`.
    """
    words = re.findall(r"[a-z]+|\d", request.lower())
    named = list(iter_named(request, vocabulary))
    said = replace(vocabulary, postures=_find_postures(request, vocabulary))
    wanted, kept = (_narrow(texts(said), request, vocabulary) for texts in (list_wanted, list_kept))
    if not {*read_lexicon()["ending"]["words"]}.isdisjoint(
        words
    ):  # else a model could choose the contrary of what is said
        wanted += _narrow(list_ended(said), request, vocabulary)
    wanted = [text for text in wanted if all(names & _find(text) for _, names in named)] or wanted
    if len(wanted) + len(kept) > STATEMENTS_MAX or any(word.isdigit() or word in NUMBERS[2:] for word in words):
        return {"wanted": {"type": "string"}, "kept": {"type": "string"}}
    return {"wanted": {"enum": wanted}, "kept": {"enum": kept}}


def _narrow(texts: list[str], request: str, vocabulary: Vocabulary) -> list[str]:
    """The statements about what a request can mean; all where none is."""
    meant = _find_meant(request, vocabulary)
    return [text for text in texts if _find(text) <= meant] or texts


def list_wanted(vocabulary: Vocabulary) -> list[str]:
    """Statements that a skill can bring about, about objects that are fit for them; `on` a tray is `inside` it."""
    return [text for _, text in _iter_wanted(vocabulary)]


def list_ended(vocabulary: Vocabulary) -> list[str]:
    """Statements about places that end when the object is brought elsewhere, as what is not to be so any more."""
    return [f"not {text}" for each, text in _iter_wanted(vocabulary) if each.meaning in _ENDED]


def _iter_wanted(vocabulary: Vocabulary) -> Iterator[tuple[PredicateDefinition, str]]:
    for each in get_predicate_library():
        for text in () if each.is_number else _iter_filled(each, vocabulary):
            if not any(_iter_lacks(text, vocabulary)):
                yield each, text


def list_kept(vocabulary: Vocabulary) -> list[str]:
    """Statements that may have to hold all through."""
    kept = [(each, _KEPT[each.meaning]) for each in get_predicate_library() if each.meaning in _KEPT]
    filled = ((form, text) for each, form in kept for text in _iter_filled(each, vocabulary))
    return [form.format(text) for form, text in filled if not any(find_unfit(_parse_call(text), vocabulary))]


def find_disagreements(request: str, goal: WantedGoal, vocabulary: Vocabulary) -> list[str]:
    """Where a goal leaves out an object that words of the request name, or is about one that none of them can mean.

    A request that names nothing here, as one in another language, agrees with every goal: a person decides.
    """
    wanted = frozenset[str]().union(*map(_find, (*goal.accept, *(text for step in goal.steps for text in step))))
    about = wanted.union(*map(_find, goal.constraints))
    left_out = [words for words, names in iter_named(request, vocabulary) if not names & about]
    if not names_anything(request, vocabulary):
        return []
    return [
        *(f"the goal says nothing of {words!r}" for words in left_out),
        *(f"no word of the request means {name}" for name in sorted(wanted - _find_meant(request, vocabulary))),
    ]


def names_anything(request: str, vocabulary: Vocabulary) -> bool:
    """Whether a word of a request names something of the scene, or can mean any of it."""
    return bool(_find_meant(request, vocabulary) or _find_postures(request, vocabulary))


def _find_meant(request: str, vocabulary: Vocabulary) -> frozenset[str]:
    """All objects that the nouns of a request can mean; every one where a word in it can mean any."""
    if not {*read_lexicon()["general"]["words"]}.isdisjoint(request.lower().split()):
        return frozenset(vocabulary.objects)
    return frozenset[str]().union(*(names for _, names in iter_named(request, vocabulary)))


def _find_postures(request: str, vocabulary: Vocabulary) -> tuple[str, ...]:
    """The postures that a request names."""
    return tuple(each for each in vocabulary.postures if each.replace("_", " ") in request.lower())


def _find(text: str) -> frozenset[str]:
    """The objects of a statement, without the robot."""
    return frozenset(find_entities(text)) - {ROLE}


def iter_named(request: str, vocabulary: Vocabulary) -> Iterator[tuple[str, frozenset[str]]]:
    """Words of the scene, and the objects that each noun with the adjectives before it can mean."""
    adjectives, nouns = vocabulary.list_words()
    singular = {plural: noun for noun in nouns for plural in (noun, pluralise(noun))}
    before: list[str] = []
    spoken = re.findall(r"[a-z]+|[,;]", request.lower())
    for word, after in zip(spoken, [*spoken[1:], ""], strict=True):
        if after in singular and word in adjectives:  # `the cupboard door`
            before = [*before, word]
            continue
        if noun := singular.get(word):
            called = (each for each in vocabulary.objects.values() if noun in each.heads)
            if found := frozenset(each.name for each in called if each.words.issuperset(before)):
                yield " ".join((*before, word)), found
        before = [*before, word] if word in adjectives and word not in singular else []


def _iter_filled(definition: PredicateDefinition, vocabulary: Vocabulary) -> Iterator[str]:
    """A predicate of each choice of objects; its numbers have their defaults, and without those there is none."""
    names = {
        ArgumentKind.ENTITY: [name for name, item in vocabulary.objects.items() if item.kind != REGION],
        ArgumentKind.CONTAINER: list(vocabulary.objects),
        ArgumentKind.PLACE: [name for name, item in vocabulary.objects.items() if item.kind == REGION],
        ArgumentKind.TARGET: [ROLE],
        ArgumentKind.POSTURE: list(vocabulary.postures),
    }
    arguments = [each for each in definition.arguments if each.default is None]
    for chosen in product(*(names.get(each.kind, []) for each in arguments)) if arguments else ():
        yield f"{definition.name}({', '.join(chosen)})"


def _iter_lacks(text: str, vocabulary: Vocabulary) -> Iterator[object]:
    call = _parse_call(text)
    said = read_statement(call)
    if (
        said.meaning is Meaning.ON
        and isinstance(said.place, syntax.Name)
        and vocabulary.objects[said.place.text].has_interior
    ):
        yield said
    yield from find_unfit(call, vocabulary)
    yield from find_incapable(call, vocabulary)


def _parse_call(text: str) -> syntax.Call:
    formula = parse_predicate(text).formula
    assert isinstance(formula, syntax.Call)
    return formula
