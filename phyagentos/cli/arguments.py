"""Options that several commands share; for names of files see `assembly.project`."""

from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.outcome import print_note
from phyagentos.operations.workspaces import get_newest

_SET_HELP = "A parameter, NAME=VALUE, or a role, targets.ROLE=NAME. Repeatable."
_RUN_HELP = "Execute the behaviours.py of skills, which is not done unasked."
_TRUST_HELP = "Let skills of the workspace run Python that is not known from here."
Overrides = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help=_SET_HELP)]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON on stdout.")]
RunPython = Annotated[bool, typer.Option("--run-python", help=_RUN_HELP)]
TrustPython = Annotated[bool, typer.Option("--trust-python", help=_TRUST_HELP)]


def choose_newest() -> Path:
    """The workspace that a reading command means that is given none; says which. Raises `NOT_A_WORKSPACE`."""
    found, count = get_newest()
    print_note(f"workspace {found} (the newest of {count})")
    return found
