"""What a safety layer changed, where it was allowed to: told in the evidence, apart from what a skill did."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Intervention:
    """One number that was changed because a contract or safety.yaml lets it.

    Attributes:
        code: Why.
        where: Joint or column (`joint2`, `x`, `gripper`).
        row: Row of the command or chunk, counted from 0.
    """

    code: str
    where: str
    row: int
    before: float
    after: float
