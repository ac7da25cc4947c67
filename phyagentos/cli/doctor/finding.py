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
    """One line of the report; `fix` is empty where all is fine."""

    subject: str
    grade: Grade
    found: str
    fix: str = ""
