"""What judgements are for. A file of its own: readers of the journal load no parser of settings."""

from enum import StrEnum


class VerificationMode(StrEnum):
    """What a judgement is for."""

    OFF = "off"
    """Nothing is judged; what was executed stays unverified and is never called a success."""
    AUDIT = "audit"
    """Everything is judged and recorded; whether the execution completed decides."""
    ENFORCE = "enforce"
    """The verdict decides; what was not met has failed."""
    RECOVERY = "recovery"
    """The verdict decides; what was not met is replanned as long as the budget lasts."""
