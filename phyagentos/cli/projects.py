"""Which library a command uses, and which file an argument means.

A project is a folder with any of goal_graphs/, trees/, skills/, scenes/, robots/, faults/. The folder of the given file
comes first, then the working directory, then installed libraries and what ships.
"""

from pathlib import Path

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.capabilities.library import Library

FOLDERS = ("goal_graphs", "trees", "skills", "scenes", "robots", "faults", "protocol")


def find_project(path: Path) -> Path:
    """The project folder that a file lies in; its own folder when none is recognised."""
    resolved = path.resolve()
    for parent in resolved.parents:
        if parent.name in FOLDERS:
            return parent.parent
    return resolved if resolved.is_dir() else resolved.parent


def open_library(*paths: Path) -> Library:
    """The library as seen from the projects of these files, and from here."""
    return Library.open(*(find_project(path) for path in paths), Path.cwd())


def get_file(argument: Path, folder: str) -> Path:
    """The file that an argument means: a path, or a name or path inside the libraries' `folder` (`tidy_table`).

    Raises:
        DefinitionError: With the names that would have been found.
    """
    if argument.is_file():
        return argument
    roots = open_library().roots
    for root in roots:
        for candidate in (root / argument, root / folder / argument, root / folder / f"{argument}.yaml"):
            if candidate.is_file():
                return candidate
    known = sorted({path.stem for root in roots for path in (root / folder).glob("*.yaml")})
    raise DefinitionError(
        Problem(
            code="UNKNOWN_FILE",
            address=str(argument),
            found="no such file",
            expected=f"a path, or one of: {format_names(known)}",
            hint=format_hint(argument.stem, known),
        )
    )
