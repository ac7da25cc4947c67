"""Findings of preflight, and their form as data. The six fields of the paper's rejection."""

from collections.abc import Iterable

import msgspec

from phyagentos.errors import Problem
from phyagentos.protocol.sessions.session import Session


def make_problem(
    code: str,
    address: str,
    found: object,
    expected: str,
    triggered_by: str = "",
    fix: str = "",
    subject: str = "",
    kind: str = "",
) -> Problem:
    """One finding; the address is completed with the session's id by `locate`."""
    shown = found if isinstance(found, str) else f"{found:g}" if isinstance(found, float) else repr(found)
    return Problem(code, address, shown, expected, fix, triggered_by, subject, kind)


def locate(session: Session, problems: Iterable[Problem]) -> list[Problem]:
    """The same problems, each with this session's address."""
    return [msgspec.structs.replace(problem, address=f"{session.id}: {problem.address}") for problem in problems]
