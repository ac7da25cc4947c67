"""Options that several commands share, and the workspaces that they mean; for names of files see `assembly.project`."""

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.outcome import print_note
from phyagentos.errors import DefinitionError
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import MARKER

_SET_HELP = "A parameter, NAME=VALUE, or a role, targets.ROLE=NAME. Repeatable."
_RUN_HELP = "Execute the behaviours.py of skills, which is not done unasked."
_TRUST_HELP = "Let skills of the workspace run Python that is not known from here."
Overrides = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help=_SET_HELP)]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON on stdout.")]
RunPython = Annotated[bool, typer.Option("--run-python", help=_RUN_HELP)]
TrustPython = Annotated[bool, typer.Option("--trust-python", help=_TRUST_HELP)]


def find_workspaces() -> list[Path]:
    """The working directory where it is a workspace, and those in `workspaces/`; what was written last comes first."""
    markers = [path for path in (Path(MARKER), *Path("workspaces").glob(f"*/{MARKER}")) if path.is_file()]
    written = {marker.parent: [marker, *marker.parent.glob("sessions/*/*.md")] for marker in markers}
    return sorted(written, key=lambda root: max(path.stat().st_mtime for path in written[root]), reverse=True)


def choose_newest() -> Path:
    """The workspace that a reading command means that is given none; says which. Raises `NOT_A_WORKSPACE`."""
    found = find_workspaces()
    if not found:
        wanted, hint = (
            "a workspace that `paos run` has made there",
            "Name one: --workspace W; `paos store` takes W alone.",
        )
        raise DefinitionError.of("NOT_A_WORKSPACE", "workspaces", "none", wanted, hint)
    print_note(f"workspace {found[0]} (the newest of {len(found)})")
    return found[0]


def find_running() -> list[Path]:
    """Every workspace on this machine that a runtime of this user supervises, wherever it is."""
    roots = set()
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):  # the process of another user, or one that ended
            roots.add(Path(str(link.readlink()).removesuffix(f"/{WATCHDOG_LOCK}")))
    return sorted(root for root in roots if (root / MARKER).is_file() and is_held(root / WATCHDOG_LOCK))
