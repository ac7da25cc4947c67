"""Every error code: in which phase it comes, what it means, who acts, and whether trying again can help.

docs/error_codes.md is generated from it. A test finds codes that are missing here, and entries that no code raises.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from phyagentos import code_tables


class Phase(StrEnum):
    """Where on its way a goal was."""

    AUTHORING = "authoring"
    """A file that a person wrote is read, linted or compiled."""
    OPERATION = "operation"
    """A command of the operator."""
    STORE = "store"
    """The journal and the documents."""
    PREFLIGHT = "preflight"
    """A session is compared with its target; nothing has moved."""
    PLANNING = "planning"
    """A motion is sought."""
    EXECUTION = "execution"
    """A skill runs."""
    SAFETY = "safety"
    """A command was refused."""
    TARGET = "target"
    """The target and its wire."""
    VERIFICATION = "verification"
    """Evidence is judged."""


class Actor(StrEnum):
    """Who has to do something about it."""

    AUTHOR = "author"
    """The author of the file."""
    OPERATOR = "operator"
    """The operator of this machine and its robot."""
    AGENT = "agent"
    """The agent plane: it replans, or gives up for a reason."""
    RUNTIME = "runtime"
    """The runtime plane: it restarts what died and observes."""


class Retry(StrEnum):
    """What another attempt is worth."""

    NEVER = "never"
    """The same will happen again."""
    EDITED = "edited"
    """Once a file or an argument has been edited."""
    LATER = "later"
    """Once the machine or the target is well again."""
    REPLANNED = "replanned"
    """As a child session, compiled from the world as it is now."""
    OBSERVED = "observed"
    """Only after a fresh observation: what happened is not known."""
    ELSEWHERE = "elsewhere"
    """On another host, which observes its own world before it begins."""


@dataclass(frozen=True, slots=True)
class Code:
    """One row of the table."""

    name: str
    phase: Phase
    meaning: str
    actor: Actor
    retry: Retry


CODES: Mapping[str, Code] = {
    name: Code(name, Phase(phase), meaning, Actor(actor), Retry(retry))
    for (phase, actor, retry), rows in code_tables.ROWS.items()
    for name, meaning in (row.split(maxsplit=1) for row in rows.strip().splitlines())
}
ALIASES: Mapping[str, str] = {
    old: new
    for line in code_tables.ALIASES.strip().splitlines()
    for new, olds in [line.split(": ")]
    for old in olds.split()
}
"""Codes of earlier releases -> what they are called now."""


def get_present_name(name: str) -> str:
    """What a code is called now, which a document of an earlier release may hold."""
    return ALIASES.get(name, name)


def find_code(name: str) -> Code | None:
    """The row of a code, also of one by which an earlier release called it; None where there is none."""
    return CODES.get(get_present_name(name))
