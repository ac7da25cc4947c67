"""Phrases of a request as trees: their parts and words.

Upstream: a reading. Downstream: all that says what phrases mean.
"""

import re
from collections.abc import Sequence

from lark import Token, Tree

Node = Tree[Token]
_NUMBERS = "zero one two three four five six seven eight nine ten eleven twelve"
_TEENS = "thirteen fourteen fifteen sixteen seventeen eighteen nineteen twenty"
NUMBERS = [*re.findall(r"\w+", f"{_NUMBERS} {_TEENS}")]


def list_tokens(tree: Node) -> list[Token]:
    """All words of a phrase; its `meta` is lost where a part of it has several readings."""
    return list(tree.scan_values(lambda each: isinstance(each, Token)))


def list_children(tree: Node) -> list[Node]:
    """Parts of a phrase that are phrases."""
    return [child for child in tree.children if isinstance(child, Tree)]


def find_child(tree: Node, rule: str) -> Node | None:
    """The part of a phrase that a rule made, or None."""
    return next((child for child in list_children(tree) if child.data == rule), None)


def read_number(tree: Node) -> int:
    """The number that a phrase itself says, 0 without one."""
    said = next((str(each) for each in tree.children if get_type(each) == "number"), "zero")
    return NUMBERS.index(said) if said in NUMBERS else int(said)


def has_token(tree: Node, terminal: str) -> bool:
    """Whether a phrase itself, not its parts, has a word of some kind."""
    return any(get_type(child) == terminal for child in tree.children)


def is_open(noun: Node) -> bool:
    """Whether a phrase is about any or all of several, so that an exception after it can be of these."""
    return any(find_child(noun, each) is not None for each in ("any", "all", "different", "number", "exactly"))


def find_side(levels: Sequence[Node], side: str) -> set[int]:
    """Which ends of a tower are said to be at a side: 0 the first, -1 the last."""
    return {end for end in (0, -1) if levels and has_token(levels[end], side)}


def get_type(part: object) -> str:
    """The terminal of a word; empty for a phrase."""
    return part.type.lower() if isinstance(part, Token) else ""
