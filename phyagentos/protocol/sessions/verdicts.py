"""Judgements: what was asked, what was seen, what follows. Paper section 4.2 (SessionVerifier)."""

from enum import StrEnum

import msgspec

from phyagentos.protocol.documents.markdown import format_value
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.world.idealisations import Idealisation
from phyagentos.protocol.world.truth import Truth


class Verdict(StrEnum):
    """What the verifier decides about one session."""

    SUCCESS = "success"
    """Every criterion is true on the evidence."""
    FAILURE = "failure"
    """The objective was not met and no revision is worth its budget."""
    REPLAN = "replan"
    """The objective is unmet or undecided; a child session follows."""
    UNVERIFIED = "unverified"
    """Not judged, because verification is off; never a success."""

    @property
    def is_miss(self) -> bool:
        """Whether an objective was judged as not met."""
        return self in {Verdict.FAILURE, Verdict.REPLAN}


PERSON = "person/1"  # the verifier of a judgement with which a person contests a verdict
CAUSE_UNKNOWN = "UNKNOWN"  # code of a miss that names no other cause


class Criterion(msgspec.Struct, frozen=True, kw_only=True):
    """One judged predicate.

    Attributes:
        text: The predicate as authored, after substitution.
        kind: `accept`, `hold`, `constraint`, `requires`; `metric` of the settings, `vision`, `lookahead`.
        truth: Its value.
        measured: The numbers that decided it (name -> value; units in the names).
        evidence: File of the bundle that was read.
        at_s: Simulated time of the deciding observation [s].
        because: One sentence for people.
        failure: Coded reason why its judge gave no usable answer; left out where it answered.
        alternatives: Objects that nothing tells apart, where the value depends on which has which name.
        shown: SHA-256 of the context that a model was shown for it; the text stands in `shown/` of the bundle.
    """

    text: str
    kind: str
    truth: Truth
    measured: dict[str, float | str | bool] = {}
    evidence: str = ""
    at_s: float | None = None
    because: str = ""
    failure: str | msgspec.UnsetType = msgspec.UNSET
    alternatives: tuple[str, ...] | msgspec.UnsetType = msgspec.UNSET
    shown: str | msgspec.UnsetType = msgspec.UNSET

    @property
    def sentence(self) -> str:
        """Why it has this value: in words, else the numbers."""
        return self.because or ", ".join(f"{name} {format_value(value)}" for name, value in self.measured.items())


class EvidenceReference(msgspec.Struct, frozen=True, kw_only=True):
    """One file that a judgement read.

    Attributes:
        file: Its name in the bundle.
        sha256: Of its bytes, hexadecimal.
    """

    file: str
    sha256: str


class Support(msgspec.Struct, frozen=True, kw_only=True):
    """One fact of the evidence that a diagnosis rests on.

    Attributes:
        file: Of the bundle.
        field: What in it.
        value: As it stands there.
    """

    file: str
    field: str
    value: float | str | bool


class Attempt(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One judgement of one session; attempts are appended, never rewritten.

    Attributes:
        verdict: The decision.
        criteria: Each criterion with the evidence that it used.
        cause: Coded cause of what went wrong (`GRASP_LOST`); empty on success, never of a miss.
        reason: What decided, in a sentence for people.
        sensing: `truth` or `perceived`.
        verifier: Name and version of the verifier.
        mode: What the judgement was for.
        judges: Who was asked, each with its version and configuration, in this order.
        found: By the criteria; differs from the verdict only where the mode lets something else decide.
        missing_evidence: Objects that must be seen again, because a criterion about them is unknown.
        evidence: The files that were read.
        kind: Class of the cause (`grasp`, `external disturbance`), empty on success.
        support: The facts that the cause rests on.
        idealisations: What of the target and its world was simpler than reality.
        is_review: Whether it was added to a session that had its verdict, and changed nothing.
    """

    verdict: Verdict
    criteria: tuple[Criterion, ...]
    cause: str = ""
    reason: str = ""
    sensing: str = "truth"
    verifier: str = "session_verifier/2"
    mode: VerificationMode = VerificationMode.RECOVERY
    judges: tuple[str, ...] = ()
    found: Verdict | None = None
    missing_evidence: tuple[str, ...] = msgspec.field(default=(), name="wants")
    evidence: tuple[EvidenceReference, ...] = ()
    is_review: bool = False
    kind: str = ""
    support: tuple[Support, ...] = ()
    idealisations: tuple[Idealisation, ...] = ()

    def __post_init__(self) -> None:
        """A miss has a cause; records of before may hold none."""
        if self.verdict.is_miss and not self.cause:
            msgspec.structs.force_setattr(self, "cause", CAUSE_UNKNOWN)
