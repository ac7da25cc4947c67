"""The three truth values of predicates (Kleene's strong logic)."""

from enum import StrEnum


class Truth(StrEnum):
    """Kleene's three values; unknown is never success."""

    TRUE = "true"
    FALSE = "false"
    UNKNOWN = "unknown"

    @property
    def mark(self) -> str:
        """One character for people."""
        return {"true": "✓", "false": "✗"}.get(self, "?")
