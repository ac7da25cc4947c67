"""Predicates in the folder of a project: each `PredicateDefinition` that a file `predicates/*.py` defines.

Such a file is executed by `load_predicates` alone, once its user has consented; whatever only reads a project takes the
names from the text, and says what would execute it.
"""

import ast
from collections.abc import Iterable
from pathlib import Path

from msgspec.structs import replace

from phyagentos.errors import Problem
from phyagentos.plugins import read_source, run_file
from phyagentos.protocol.predicates import meaning, predicate
from phyagentos.protocol.predicates.library import PredicateDefinition, get_predicate_library

_OF_MEANING = (meaning.read_statement, meaning.normalize, meaning.list_kinds, meaning.state)


def load_predicates(files: Iterable[Path]) -> None:
    """Execute the files, and let every statement name their predicates, in the place of an earlier project's.

    Raises DefinitionError `BROKEN_PYTHON`; `DUPLICATE_NAME` for a name that ships or is installed.
    """
    for path in files:
        found = run_file(path).values()
        for definition in {each.name: each for each in found if isinstance(each, PredicateDefinition)}.values():
            get_predicate_library().admit(definition)
        forget_readings()


def forget_readings() -> None:
    """Read every criterion anew: what its words mean has changed."""
    for cached in (*_OF_MEANING, predicate.has_metric, predicate.read_formula):
        cached.cache_clear()


def read_predicate_names(path: Path) -> list[str]:
    """The names in calls `PredicateDefinition(name="…")` of a file; raises DefinitionError `BROKEN_PYTHON`."""
    return [
        str(word.value.value)
        for node in ast.walk(read_source(path))
        if isinstance(node, ast.Call)
        for word in node.keywords
        if word.arg == "name" and isinstance(word.value, ast.Constant)
    ]


def name_option(problems: Iterable[Problem], files: Iterable[Path]) -> list[Problem]:
    """The same problems; a predicate that one of the files defines is unknown until an option executes that file."""
    problems = list(problems)
    if all(each.kind != "predicate" for each in problems):
        return problems  # no file is looked at
    hints = {
        name: f"{path} defines it: read it; --run-python executes it."
        for path in files
        for name in read_predicate_names(path)
    }
    return [
        replace(each, hint=hints.get(each.subject, each.hint)) if each.kind == "predicate" else each
        for each in problems
    ]
