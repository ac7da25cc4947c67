"""`paos init`: a place of one's own that runs at once, copied from the templates beside this file."""

import shutil
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.outcome import print_note, print_result
from phyagentos.errors import DefinitionError

TEMPLATES = Path(__file__).with_name("scaffold")


def init(folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that is missing or empty.")]) -> None:
    """Make a place of your own: a goal graph, a scene and a skill that run at once."""
    copy_scaffold(folder)
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        print_note(f"wrote {path}")
    print_result(f"next: paos lint {folder} && paos run {folder / 'goal_graphs' / 'first.yaml'}")


def copy_scaffold(folder: Path) -> None:
    """Copy the templates; raises `WOULD_OVERWRITE` when the folder holds anything."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        found = "a file" if folder.is_file() else "a folder that is not empty"
        expected = "a folder that is missing or empty"
        raise DefinitionError.of("WOULD_OVERWRITE", str(folder), found, expected, "Choose another name.")
    shutil.copytree(TEMPLATES, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__", ".*"))
