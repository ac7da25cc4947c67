"""What a check of the machine found."""

from dataclasses import dataclass
from enum import StrEnum


class Grade(StrEnum):
    """How good it is."""

    FINE = "fine"
    """As it should be."""
    WEAK = "weak"
    """All works, something is slower or missing."""
    BROKEN = "broken"
    """A promise cannot be kept here."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the report.

    Attributes:
        subject: What was looked at.
        grade: How good it is.
        found: What was found, with units.
        fix: What to do about it; empty where it is fine.
    """

    subject: str
    grade: Grade
    found: str
    fix: str = ""
