"""Findings of preflight, and their form as data. The six fields of the paper's rejection."""

from collections.abc import Iterable, Mapping
from typing import Any

from phyagentos.errors import Problem, format_hint, format_names


def make_problem(
    code: str, address: str, found: object, expected: str, triggered_by: str = "", fix: str = "", subject: str = ""
) -> Problem:
    """One finding; the address is completed with the session's id by `locate`."""
    shown = found if isinstance(found, str) else f"{found:g}" if isinstance(found, float) else repr(found)
    return Problem(code, address, shown, expected, fix, triggered_by=triggered_by, subject=subject)


def make_unknown(
    code: str, address: str, name: str, known: Iterable[str], *, triggered_by: str = "", fix: str = ""
) -> Problem:
    """A name that is not among the known ones; the hint is the nearest of them, else `fix`."""
    names = list(known)
    hint = format_hint(name, names) or fix
    return make_problem(code, address, repr(name), format_names(names), triggered_by=triggered_by, fix=hint)


def describe_problem(problem: Problem) -> Mapping[str, Any]:
    """{code, address, found, expected, triggered_by, fix}."""
    return {
        "code": problem.code,
        "address": problem.address,
        "found": problem.found,
        "expected": problem.expected,
        "triggered_by": problem.triggered_by,
        "fix": problem.hint,
    }
