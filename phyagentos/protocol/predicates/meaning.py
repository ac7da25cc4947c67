"""Statements by what they mean: which call says that an object is inside, held or seen, and at which place.

The one way from a formula to a decision. Predicates of one meaning are taken to be true of the same objects, whatever
they measure: one of a plug-in is promised, planned for and repaired by the skills that ship. Verdicts evaluate each.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

from phyagentos.protocol.predicates.library import (
    ArgumentKind,
    Meaning,
    Part,
    PredicateDefinition,
    get_predicate_library,
)
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.predicates.syntax import (
    Call,
    Formula,
    Name,
    Number,
    Term,
    Variable,
    iter_calls,
    map_calls,
    render,
)


@dataclass(frozen=True, slots=True)
class Statement:
    """What one call says; empty for any other formula, and what its predicate does not declare.

    Attributes:
        object: What it is about.
        place: Where that is.
        number: Its first number, as a tolerance; None where it is left out.
    """

    meaning: Meaning | None = None
    object: Term | None = None
    place: Term | None = None
    number: float | None = None

    @property
    def relates(self) -> bool:
        """Whether it says where an object is: at a place, beside another object, or in a hand."""
        return self.place is not None or self.meaning is Meaning.HOLDING

    def name_object(self, written: type[Name | Variable] = Name) -> str:
        """What it is about; the place where its object is no name, or no variable, as `*` is none."""
        found = next((term for term in (self.object, self.place) if isinstance(term, written)), None)
        return "" if found is None else found.path if isinstance(found, Variable) else found.text


@lru_cache(maxsize=8192)
def read_statement(formula: Formula | None) -> Statement:
    """What a formula says where it is one call."""
    if not isinstance(formula, Call) or (definition := find_definition(formula)) is None:
        return Statement()
    terms = {part: term for term, part in zip(formula.terms, definition.parts, strict=False) if part is not None}
    number = next((term.value for term in formula.terms if isinstance(term, Number)), None)
    return Statement(definition.meaning, terms.get(Part.OBJECT), terms.get(Part.PLACE), number)


@lru_cache(maxsize=8192)
def normalize(call: Call) -> Call:
    """The same statement by the predicate that is written for its meaning; the call itself where it declares none."""
    definition = find_definition(call)
    if definition is None or definition.meaning is None:
        return call
    written = get_predicate_library().get_of_meaning(definition.meaning)
    if written is definition:
        return call
    said = dict(zip(definition.parts, call.terms, strict=False))
    others = (term for part, term in zip(definition.parts, call.terms, strict=False) if part is None)
    terms = (said.get(part) if part is not None else next(others, None) for part in written.parts)
    return Call(written.name, tuple(term for term in terms if term is not None))


def normalize_text(text: str) -> str:
    """The canonical text of a predicate, each call as `normalize` writes it."""
    return render(map_calls(parse_predicate(text, template=True).formula, normalize))


def read_meanings(texts: Iterable[str]) -> list[Meaning | None]:
    """What each call in some texts says, templates included."""
    formulas = (parse_predicate(text, template=True).formula for text in texts)
    return [read_statement(call).meaning for formula in formulas for call in iter_calls(formula)]


def only_looks(texts: Iterable[str]) -> bool:
    """Whether these texts ask for something, and for nothing but what a look brings about."""
    return {*read_meanings(texts)} == {Meaning.VISIBLE}


def find_held(text: str) -> Term | None:
    """What a text says to be in a hand, None where it says something else."""
    said = read_statement(parse_predicate(text, template=True).formula)
    return said.object if said.meaning is Meaning.HOLDING else None


def find_relation(name: str) -> Meaning:
    """How a predicate of this name has an object in or on its place; inside, where none says it."""
    definition = get_predicate_library().find(name)
    return Meaning.INSIDE if definition is None or definition.meaning is None else definition.meaning


def find_definition(call: Call) -> PredicateDefinition | None:
    """The predicate of a call, None where it is not installed."""
    return get_predicate_library().find(call.name)


@lru_cache(maxsize=8192)
def list_kinds(call: Call) -> tuple[ArgumentKind, ...]:
    """What each term of a call names."""
    definition = find_definition(call)
    return tuple(each.kind for each in definition.arguments[: len(call.terms)]) if definition is not None else ()


@lru_cache(maxsize=8192)
def state(meaning: Meaning, object: str, place: str = "") -> str:
    """The text of `make_call`."""
    return render(make_call(meaning, object, place))


def find_name(meaning: Meaning) -> str:
    """What the predicate is called that is written for a meaning."""
    return get_predicate_library().get_of_meaning(meaning).name


def make_call(meaning: Meaning, object: str, place: str = "") -> Call:
    """The call that says this of an object; raises LookupError where no predicate means it."""
    definition = get_predicate_library().get_of_meaning(meaning)
    named = {Part.OBJECT: object, Part.PLACE: place}
    return Call(definition.name, tuple(Name(named[part]) for part in definition.parts if part is not None))
