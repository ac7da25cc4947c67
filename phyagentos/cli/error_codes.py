"""`paos codes`: what an error code means, who acts, and whether trying again can help."""

from typing import Annotated

import typer

from phyagentos.cli.outcome import print_result
from phyagentos.codes import CODES, Code, Retry
from phyagentos.errors import DefinitionError, format_hint

RETRIES = {
    Retry.NEVER: "the same will happen",
    Retry.EDITED: "once something was edited",
    Retry.LATER: "once machine or target are well",
    Retry.REPLANNED: "as a child session",
    Retry.OBSERVED: "only after a fresh observation",
}


def show_codes(
    name: Annotated[str | None, typer.Argument(help="One code; without it, all.")] = None,
) -> None:
    """Explain an error code: phase, meaning, who acts, whether trying again can help."""
    if name is None:
        print_result("\n".join(_describe(code) for code in CODES.values()))
    elif code := CODES.get(name.upper()):
        print_result(_describe(code))
    else:
        raise DefinitionError.of(
            "UNKNOWN_CODE", "paos codes", repr(name), "a code of `paos codes`", format_hint(name.upper(), CODES)
        )


def _describe(code: Code) -> str:
    return f"{code.name}: {code.meaning} ({code.phase}; {code.actor} acts; again: {RETRIES[code.retry]})"
