"""What arguments mean: files and names in the library that a command uses, workspaces, parameters and roles of `--set`.

A project is a folder with any of goal_graphs/, trees/, skills/, scenes/, robots/, faults/. The folder of the given file
comes first, then the working directory, then installed libraries and what ships.
"""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.assembly.paths import find_project
from phyagentos.cli.outcome import Exit, ExitCode, print_note
from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.foreign_python import find_foreign_python
from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from phyagentos.protocol.workspace.workspace import MARKER, Workspace

_SET_HELP = "A parameter, NAME=VALUE, or a role, targets.ROLE=NAME. Repeatable."
_RUN_HELP = "Execute the behaviours.py of skills, which is not done unasked."
_TRUST_HELP = "Let skills of the workspace run Python that is not known from here."
Overrides = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help=_SET_HELP)]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON on stdout.")]
RunPython = Annotated[bool, typer.Option("--run-python", help=_RUN_HELP)]
TrustPython = Annotated[bool, typer.Option("--trust-python", help=_TRUST_HELP)]
PREFIX = "targets."


def open_library(*paths: Path) -> Library:
    """The library as seen from the projects of these files, and from here."""
    return Library.open(*(find_project(path) for path in paths), Path.cwd())


def get_file(argument: Path, folder: str) -> Path:
    """The file that an argument means: a path, or a name or path inside the libraries' `folder` (`tidy_table`)."""
    if argument.is_file():
        return argument
    roots = open_library().roots
    for root in roots:
        for candidate in (root / argument, root / folder / argument, root / folder / f"{argument}.yaml"):
            if candidate.is_file():
                return candidate
    known = sorted({path.stem for root in roots for path in (root / folder).glob("*.yaml")})
    expected = f"a path, or one of: {format_names(known)}"
    raise DefinitionError.of("UNKNOWN_FILE", str(argument), "no such file", expected, format_hint(argument.stem, known))


def get_settings(name: str, library: Library, workspace: Path | None) -> Path | None:
    """A settings file of a workspace that is there already, else the one that a new workspace gets."""
    folders = (*([workspace] if workspace is not None else []), *(root / "protocol" for root in library.roots))
    return next((folder / name for folder in folders if (folder / name).is_file()), None)


def parse_overrides(texts: Sequence[str] | None) -> dict[str, str]:
    """`["cube=red", "targets.arm=ur5e"]` as `{"parameters.cube.default": "red", "targets.arm": "ur5e"}`, or Exit."""
    pairs = [text.partition("=") for text in texts or ()]
    wrong = [key for key, _, value in pairs if "." in key.removeprefix(PREFIX) or not key or not value]
    if wrong:
        raise Exit(ExitCode.INVALID_INPUT, f"--set {wrong[0]}: expected PARAMETER=VALUE or {PREFIX}ROLE=NAME")
    return {key if key.startswith(PREFIX) else f"parameters.{key}.default": value for key, _, value in pairs}


def admit_python(root: Path, *sources: Path, is_trusted: bool) -> None:
    """Name the Python of an existing workspace that neither the projects of `sources` nor the working folder hold.

    Raises DefinitionError `UNTRUSTED_PYTHON` unless it `is_trusted`; `LEADS_OUT`.
    """
    found = find_foreign_python(Workspace.open(root), open_library(*sources)) if (root / MARKER).is_file() else ()
    if found and not is_trusted:
        expected = "a skill as in this project, in an installed package or as shipped"
        hint = "Read it; --trust-python lets it run."
        asked = [Problem("UNTRUSTED_PYTHON", str(path), "other Python", expected, hint) for path in found]
        raise DefinitionError(asked)
    for path in found:
        print_note(f"trusted Python: {path}")


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
