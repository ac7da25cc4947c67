"""`--set KEY=VALUE`: single values of a goal graph replaced on the command line; today the roles of `targets`."""

from collections.abc import Sequence
from typing import Annotated

import typer

from phyagentos.cli.outcome import Exit, ExitCode

Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Bind a role: targets.arm=NAME. Repeatable.")
]
PREFIX = "targets."


def parse_overrides(texts: Sequence[str] | None) -> dict[str, str]:
    """`["targets.arm=ur5e"]` as `{"targets.arm": "ur5e"}`; raises Exit for anything else."""
    pairs = [text.partition("=") for text in texts or ()]
    wrong = [key for key, _, value in pairs if not key.startswith(PREFIX) or not value]
    if wrong:
        raise Exit(ExitCode.INVALID_INPUT, f"--set {wrong[0]}: expected {PREFIX}ROLE=NAME")
    return {key: value for key, _, value in pairs}
