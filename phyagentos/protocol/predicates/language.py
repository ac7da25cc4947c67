"""The grammar of predicates: text to syntax tree. Knows no predicate by meaning; see `predicate_library`.

    criterion := predicate | "human:" question, which a person answers
    predicate := all ("or" all)*
    all       := unary ("and" unary)*
    unary     := "not" unary | "(" predicate ")" | atom
    atom      := call [relation (number | "${" path "}")]   relation is one of >= <= > < == !=
    call      := "count" "(" predicate ")" | name "(" [term ("," term)*] ")"
    term      := name | "*" | "${" path "}" | number | "(" number "," number "," number ")"

A tokenizer and a recursive descent are a page of code; a parser generator would be one more dependency and would give
worse messages.
"""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from phyagentos.protocol.predicates import syntax

_Part = TypeVar("_Part")
_UNITLESS = "Write numbers without units: metres, radians, seconds."
_LETTERS = "Names hold letters a to z, digits and '_', and quotes are straight; type that place again."
_SIGNS = {
    "=": "Write '==' for equal.",
    "&": "Write 'and'.",
    "|": "Write 'or'.",
    "!": "Write 'not'.",
    "'": "Write names without quotes.",
    '"': "Write names without quotes.",
    ";": "Join predicates with 'and'.",
    "°": _UNITLESS,
}
RELATIONS = (">=", "<=", "==", "!=", ">", "<")
_KEYWORDS = frozenset({"and", "or", "not", "count"})
_TOKEN = re.compile(
    r"(?P<space>\s+)"
    r"|\$\{(?P<variable>[^{}]+)\}"
    r"|(?P<number>[+-]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<sign>>=|<=|==|!=|[><(),*])"
)


class PredicateSyntaxError(ValueError):
    """Text that is no predicate; `column` counts from 1, `hint` says what was probably meant."""

    def __init__(self, column: int, found: str, expected: str, hint: str = "") -> None:
        self.column, self.found, self.expected, self.hint = column, found, expected, hint
        super().__init__(f"column {column}: found {found}; expected {expected}")


def parse(text: str) -> syntax.Formula:
    """Parse one predicate; raises PredicateSyntaxError at the first offending piece."""
    if text.startswith(syntax.HUMAN):
        if question := " ".join(text.removeprefix(syntax.HUMAN).split()):
            return syntax.Question(question)
        raise PredicateSyntaxError(len(text) + 1, "no question", "a question that a person answers with yes or no")
    parser = _Parser(tuple(_iter_tokens(text)))
    formula = parser.parse_or()
    parser.expect("end")
    return formula


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str  # name, number, variable, end, or the sign or keyword itself
    text: str
    column: int


def _iter_tokens(text: str) -> Iterator[_Token]:
    position = 0
    while position < len(text):
        if (match := _TOKEN.match(text, position)) is None:
            hint = _SIGNS.get(text[position], "" if text[position].isascii() else _LETTERS)
            expected = "a name, a number, '*', '(', or a comparison"
            raise PredicateSyntaxError(position + 1, repr(text[position]), expected, hint)
        kind = str(match.lastgroup)
        piece = match[kind].strip()
        if kind != "space":
            is_own = kind == "sign" or (kind == "name" and piece in _KEYWORDS)
            yield _Token(piece if is_own else kind, piece, position + 1)
        position = match.end()
    yield _Token("end", "the end", len(text) + 1)


class _Parser:
    """Recursive descent, one method a rule of the grammar."""

    def __init__(self, tokens: tuple[_Token, ...]) -> None:
        self._tokens = tokens
        self._position = 0
        self._depth = 0

    @property
    def _now(self) -> _Token:
        return self._tokens[self._position]

    def expect(self, *kinds: str, what: str = "") -> _Token:
        """Take the next token, which must be one of `kinds`."""
        token = self._now
        if token.kind not in kinds:
            found = token.text if token.kind == "end" else repr(token.text)
            expected = what or " or ".join("the end" if kind == "end" else repr(kind) for kind in kinds)
            raise PredicateSyntaxError(token.column, found, expected, self._advise(token))
        self._position = min(self._position + 1, len(self._tokens) - 1)
        return token

    def _advise(self, token: _Token) -> str:
        """What was probably meant by a piece that does not belong where it stands."""
        before = self._tokens[self._position - 1] if self._position else token
        if token.kind == "end":
            if sum((each.kind == "(") - (each.kind == ")") for each in self._tokens) > 0:
                return "Close every bracket, and put the whole in quotes: between [ ] a comma begins the next value."
            return f"Write what follows {before.text!r}, or leave it out." if before.kind in _KEYWORDS else ""
        if token.kind == "name" and before.kind == "number":
            return _UNITLESS
        if token.kind == "," and before.kind == "number":
            return "Write a point in a number, not a comma."
        if before.kind == ")" and token.kind == "name":
            return "Join predicates with 'and' or 'or'; compare with <, <=, >, >= or ==."
        both = token.kind == before.kind == "name" and token is not before
        if both and self._position == 1:
            first = "A predicate stands before its arguments: inside(a, b)."
            return f"{first} Write '{before.text}_{token.text}' for one name."
        name = f"Write '{before.text}_{token.text}' for one name, which has no spaces"
        return f"{name}, or a comma between two arguments." if both else ""

    def _take(self, *kinds: str) -> _Token | None:
        return self.expect(*kinds) if self._now.kind in kinds else None

    def parse_or(self) -> syntax.Formula:
        parts = self._parse_joined("or", self._parse_and)
        return parts[0] if len(parts) == 1 else syntax.Or(parts)

    def _parse_and(self) -> syntax.Formula:
        parts = self._parse_joined("and", self._parse_unary)
        return parts[0] if len(parts) == 1 else syntax.And(parts)

    def _parse_joined(self, sign: str, parse: Callable[[], _Part]) -> tuple[_Part, ...]:
        parts = [parse()]
        while self._take(sign):
            parts.append(parse())
        return tuple(parts)

    def _parse_unary(self) -> syntax.Formula:
        self._depth += 1
        if self._depth > 50:
            raise PredicateSyntaxError(self._now.column, "more than 50 levels", "a flatter predicate")
        try:
            if self._take("not"):
                return syntax.Not(self._parse_unary())
            if self._take("("):
                inner = self.parse_or()
                self.expect(")")
                return inner
            return self._parse_atom()
        finally:
            self._depth -= 1

    def _parse_atom(self) -> syntax.Formula:
        head = self.expect("name", "count", what="a predicate, 'not' or '('")
        self.expect("(")
        left: syntax.Call | syntax.Count
        if head.kind == "count":
            if self._now.kind == "name" and self._tokens[self._position + 1].kind == ")":
                hint = f"Write count(inside(*, {self._now.text})) for how many are in it."
                raise PredicateSyntaxError(
                    self._now.column, repr(self._now.text), "a predicate with its arguments", hint
                )
            left = syntax.Count(self.parse_or(), head.column)
        else:
            left = syntax.Call(head.text, self._parse_terms(), head.column)
        self.expect(")", what="',' or ')'")
        relation = self._take(*RELATIONS)
        if relation is None:
            return left
        if variable := self._take("variable"):
            return syntax.Compare(left, relation.kind, syntax.Variable(variable.text, variable.column))
        return syntax.Compare(left, relation.kind, self._parse_number("a number"))

    def _parse_terms(self) -> tuple[syntax.Term, ...]:
        return () if self._now.kind == ")" else self._parse_joined(",", self._parse_term)

    def _parse_term(self) -> syntax.Term:
        token = self.expect("name", "*", "variable", "number", "(", what="a name, '*', a number or a point (x, y, z)")
        match token.kind:
            case "name":
                return syntax.Name(token.text, token.column)
            case "*":
                return syntax.Star(token.column)
            case "variable":
                return syntax.Variable(token.text, token.column)
            case "number":
                return syntax.Number(_to_float(token), token.column)
        x = self._parse_coordinate(",")
        y = self._parse_coordinate(",")
        return syntax.Point((x, y, self._parse_coordinate(")")), token.column)

    def _parse_coordinate(self, then: str) -> float:
        value = self._parse_number("a coordinate [m]")
        self.expect(then, what="',' and another number, three in all" if then == "," else "")
        return value

    def _parse_number(self, what: str) -> float:
        return _to_float(self.expect("number", what=what))


def _to_float(token: _Token) -> float:
    value = float(token.text)
    if not math.isfinite(value):
        raise PredicateSyntaxError(token.column, token.text, "a finite number")
    return value
