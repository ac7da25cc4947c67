"""The trace of a skill: which leaf did what, in which role. `trace.jsonl` of an evidence bundle.

Diagnosis and repair rest on the roles that leaves declare; names of leaves are for people.
"""

from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple

import msgspec

from phyagentos.protocol.documents.plain_data import Fields


class Role(StrEnum):
    """What a leaf does in a skill. Ports and numbers that a reader may rely on are named with the role."""

    SENSE = "sense"
    """Observes or computes; moves nothing."""
    PLAN_GRASP = "plan_grasp"
    """Finds ways to take hold of its input `object`; its number `labels` names them."""
    PLAN_SITE = "plan_site"
    """Finds ways to put the held object down (inputs `destination`, `relation`, `near`); `labels` names them."""
    PLAN_ROOM = "plan_room"
    """Finds what has to go from where the input `object` is put (`destination`, `relation`, `near`), or out of the hand
    that is to take it: its `things`."""
    PLAN = "plan"
    """Finds any other way."""
    MOVE = "move"
    """Moves the arm and what it holds; `label` names the way that was chosen."""
    HOME = "home"
    """Moves the arm to its home posture, or to the one that its input `posture` names."""
    GRASP = "grasp"
    """Closes the fingers."""
    VERIFY = "verify"
    """Succeeds when the object is held: the first time after a grasp it is gripped, later it is lifted."""
    CARRY = "carry"
    """From here on the object counts as part of the hand."""
    OPEN = "open"
    """Opens the fingers."""
    RELEASE = "release"
    """Succeeds when the object has left the hand; `position_m` is where."""
    WAIT = "wait"
    """Lets simulated time pass."""
    DECIDE = "decide"
    """Judges a condition, or fails on purpose."""
    ACT = "act"
    """Commands the target by itself, as a policy does."""


STILL = frozenset({Role.SENSE, Role.GRASP, Role.VERIFY, Role.CARRY, Role.OPEN, Role.WAIT})
"""Roles that leave every object where it is."""

_OF_EARLIER_BUNDLES = {
    "locate": Role.SENSE,
    "look": Role.SENSE,
    "plan_grasp": Role.PLAN_GRASP,
    "plan_place": Role.PLAN_SITE,
    "move_to": Role.MOVE,
    "move_linear": Role.MOVE,
    "move_level": Role.MOVE,
    "close_gripper": Role.GRASP,
    "verify_grasp": Role.VERIFY,
    "attach": Role.CARRY,
    "open_gripper": Role.OPEN,
    "detach": Role.RELEASE,
    "policy": Role.ACT,
}
"""Leaf -> role, for bundles that were recorded before leaves declared theirs."""


class Contact(NamedTuple):
    """Two bodies that a planned motion would bring together; a planner counts them among its reasons."""

    body: str
    other: str

    def __str__(self) -> str:
        """`link5|wall`."""
        return "|".join(self)

    @classmethod
    def parse(cls, reason: str) -> "Contact | None":
        """The contact that a reason names; None of another reason."""
        body, bar, other = reason.partition("|")
        return cls(body, other) if bar else None


class TraceEvent(msgspec.Struct, frozen=True, kw_only=True):
    """One node of the tree changed its status.

    Attributes:
        tick: Number of the tree tick that carried a command (thinking ticks do not count).
        time_s: Simulated time.
        path: Slash-separated names from the root (`pick_and_place/pick/plan_grasp`).
        leaf: Type of the node (`plan_grasp`, `sequence`).
        status: `RUNNING`, `SUCCESS`, `FAILURE`, `INVALID`.
        declared_role: As its leaf declares it; None of control nodes, and in earlier bundles.
        code: Coded reason of a failure.
        message: One sentence for people.
        numbers: What it measured or decided.
    """

    tick: int
    time_s: float
    path: str
    leaf: str
    status: str
    declared_role: Role | None = msgspec.field(default=None, name="role")
    code: str = ""
    message: str = ""
    numbers: Fields = {}

    @property
    def role(self) -> Role | None:
        """What the leaf did; of an earlier bundle by the leaf's type, None of a control node."""
        return self.declared_role or _OF_EARLIER_BUNDLES.get(self.leaf)

    @property
    def is_success(self) -> bool:
        """Whether the node succeeded."""
        return self.status == "SUCCESS"


def find_label(trace: Iterable[TraceEvent], role: Role) -> str:
    """Label of the way that was last carried out, of those that a planning leaf had found; empty without one.

    `role` is that of the planning leaf: `PLAN_GRASP` or `PLAN_SITE`.
    """
    found: set[str] = set()
    chosen = ""
    for event in trace:
        if event.role is role and event.is_success:
            found = set(event.numbers.get("labels", ()))
        elif event.numbers.get("label") in found:
            chosen = str(event.numbers["label"])
    return chosen
