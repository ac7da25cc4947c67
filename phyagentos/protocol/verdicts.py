"""Judgements: what was asked, what was seen, what follows. Paper section 4.2 (SessionVerifier)."""

from enum import StrEnum

import msgspec


class Truth(StrEnum):
    """Kleene's three values; unknown is never success."""

    TRUE = "true"
    FALSE = "false"
    UNKNOWN = "unknown"


class Verdict(StrEnum):
    """What the verifier decides about one session."""

    SUCCESS = "success"
    """Every criterion is true on the evidence."""
    FAILURE = "failure"
    """The objective was not met and no revision is worth its budget."""
    REPLAN = "replan"
    """The objective was not met; a child session with a revised strategy follows."""


class Criterion(msgspec.Struct, frozen=True, kw_only=True):
    """One judged predicate.

    Attributes:
        text: The predicate as authored, after substitution.
        kind: `accept`, `hold`, `constraint` or `requires`.
        truth: Its value.
        measured: The numbers that decided it (name -> value; units in the names).
        evidence: File of the bundle that was read.
        at_s: Simulated time of the deciding observation [s].
        because: One sentence for people.
    """

    text: str
    kind: str
    truth: Truth
    measured: dict[str, float | str | bool] = {}
    evidence: str = ""
    at_s: float | None = None
    because: str = ""


class Attempt(msgspec.Struct, frozen=True, kw_only=True):
    """One judgement of one session; attempts are appended, never rewritten.

    Attributes:
        verdict: The decision.
        criteria: Each criterion with the evidence that it used.
        cause: Coded cause of what went wrong, empty on success (`GRASP_LOST`, `OBJECT_GONE`).
        reason: One sentence that names the layer, the leaf and the number that decided.
        sensing: `truth` or `perceived`.
        verifier: Name and configuration of the verifier.
    """

    verdict: Verdict
    criteria: tuple[Criterion, ...]
    cause: str = ""
    reason: str = ""
    sensing: str = "truth"
    verifier: str = "predicates/1"
