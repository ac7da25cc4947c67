"""Other means to the end of a session than those of its node: skill, target, parameters, and what comes before it.

A strategy (`strategy`) is carried out by the skill; means change the contract itself, within its acceptance and limits.
"""

import msgspec

from phyagentos.protocol.documents.plain_data import Fields


class Preparation(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A session that comes before the attempt: an order, or a precondition that nothing else brings about.

    Attributes:
        purpose: As in a contract: `clear`.
        skill: That did it.
        kind: Kind of the object that it acted on; empty for the object of the attempt itself.
    """

    purpose: str
    skill: str
    kind: str = ""

    def __str__(self) -> str:
        """`set_aside of a post first`."""
        return f"{self.skill} of {f'a {self.kind}' if self.kind else 'it'} first"


class Means(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a session does by other means than its node says; means without any are false.

    Attributes:
        skill: Another one that covers the same guarantees; its parameters follow from these.
        target: Another one.
        parameters: Other values, by name.
        prepare: What comes before it, in this order.
    """

    skill: str = ""
    target: str = ""
    parameters: Fields = {}
    prepare: tuple[Preparation, ...] = ()

    def __bool__(self) -> bool:
        """Whether anything is done by other means."""
        return self != DEFAULT_MEANS

    def __str__(self) -> str:
        """`set_aside of a post first, push instead`; empty for the node's own."""
        parts = [*map(str, self.prepare)]
        parts += [f"{self.skill} instead"] if self.skill else []
        parts += [f"on {self.target}"] if self.target else []
        return ", ".join([*parts, *(f"{key} {value}" for key, value in sorted(self.parameters.items()))])


DEFAULT_MEANS = Means()
"""As the node says."""
