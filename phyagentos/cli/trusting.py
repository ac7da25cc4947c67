"""Before a command runs Python of a workspace: what is not known from here is named, and runs only if allowed."""

from pathlib import Path

from phyagentos.cli.arguments import open_library
from phyagentos.cli.outcome import print_note
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.workspace.foreign_python import find_foreign_python
from phyagentos.protocol.workspace.workspace import MARKER, Workspace


def admit_python(root: Path, *sources: Path, is_trusted: bool) -> None:
    """Name the Python of an existing workspace that neither the projects of `sources` nor the working folder hold.

    Raises:
        DefinitionError: `UNTRUSTED_PYTHON` unless it `is_trusted`; `LEADS_OUT`.
    """
    if not (root / MARKER).is_file():
        return
    found = find_foreign_python(Workspace.open(root), open_library(*sources))
    if found and not is_trusted:
        expected = "a skill as in this project, in an installed package or as shipped"
        hint = "Read it; --trust-python lets it run."
        raise DefinitionError(
            [Problem("UNTRUSTED_PYTHON", str(path), "other Python", expected, hint) for path in found]
        )
    for path in found:
        print_note(f"trusted Python: {path}")
