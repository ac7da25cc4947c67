"""Before a command runs Python of a workspace: what is not known from here is named, and runs only if allowed."""

from pathlib import Path

from phyagentos.assembly import project
from phyagentos.cli.outcome import print_note


def admit_python(root: Path, *sources: Path, is_trusted: bool) -> None:
    """As `project.admit_python`; what is trusted is printed."""
    for path in project.admit_python(root, *sources, is_trusted=is_trusted):
        print_note(f"trusted Python: {path}")
