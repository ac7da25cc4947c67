"""Files and names of a project: what a path or a name means, parameters and roles of `--set`, whose Python may run.

A project is a folder with any of goal_graphs/, trees/, skills/, predicates/, scenes/, robots/, faults/. The folder of
the given file comes first, then the working directory, then installed libraries and what ships.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.predicates.project_predicates import load_predicates
from phyagentos.protocol.settings.safety import Safety, read_safety
from phyagentos.protocol.workspace.foreign_python import find_foreign_python
from phyagentos.protocol.workspace.workspace import MARKER, Workspace

PREFIX = "targets."
FOLDERS = ("goal_graphs", "trees", "skills", "predicates", "scenes", "robots", "faults", "protocol")


def find_project(path: Path) -> Path:
    """The project folder of a file; its own folder when none is recognised."""
    resolved = path.resolve()
    own = resolved if resolved.is_dir() else resolved.parent
    return next((parent.parent for parent in resolved.parents if parent.name in FOLDERS), own)


def open_library(*paths: Path) -> Library:
    """The library as seen from the projects of these files, and from here."""
    return Library.open(*(find_project(path) for path in paths), Path.cwd())


def get_file(argument: Path, folder: str) -> Path:
    """The file that an argument means: a path, or a name or path inside the libraries' `folder` (`tidy_table`)."""
    if argument.is_file():
        return argument
    roots = open_library().roots
    names = (argument, Path(folder) / argument, Path(folder) / f"{argument}.yaml")
    if (found := next((root / name for root in roots for name in names if (root / name).is_file()), None)) is not None:
        return found
    files = {path.relative_to(root / folder) for root in roots for path in (root / folder).rglob("*.yaml")}
    known = sorted(path.with_suffix("").as_posix() for path in files)
    hint = format_hint(argument.with_suffix("").as_posix(), known)
    expected = f"a path or a name in {folder}/" if hint else f"a path, or one of: {format_names(known)}"
    raise DefinitionError.of("UNKNOWN_NAME", str(argument), "no such file", expected, hint, "file")


def get_settings(name: str, library: Library, workspace: Path | None) -> Path | None:
    """A settings file of a workspace that is there already, else the one that a new workspace gets."""
    folders = (*([workspace] if workspace is not None else []), *(root / "protocol" for root in library.roots))
    return next((folder / name for folder in folders if (folder / name).is_file()), None)


def read_limits(library: Library, *targets: str) -> Safety:
    """The limits that hold in a new workspace for these targets, with those that stand beside their profiles."""
    files = [root / "protocol" / "safety.yaml" for root in library.roots]
    files += [library.get_target(each).with_name("safety.yaml") for each in targets]
    found = [read_safety(each) for each in files if each.is_file()]
    return Safety(targets={name: limits for each in found for name, limits in each.targets.items()})


def parse_overrides(texts: Sequence[str] | None) -> dict[str, str]:
    """`cube=red` as `{"parameters.cube.default": "red"}`, `targets.arm=ur5e` as it is; raises `INVALID_VALUE`."""
    pairs = [text.partition("=") for text in texts or ()]
    wrong = [key for key, _, value in pairs if "." in key.removeprefix(PREFIX) or not key or not value]
    if wrong:
        raise DefinitionError.of("INVALID_VALUE", "--set", wrong[0], f"PARAMETER=VALUE or {PREFIX}ROLE=NAME")
    return {key if key.startswith(PREFIX) else f"parameters.{key}.default": value for key, _, value in pairs}


def admit_python(
    root: Path,
    *sources: Path,
    is_trusted: bool,
    announce: Callable[[str], object] = str,
    find: Callable[[Workspace, Library], list[Path]] = find_foreign_python,
) -> None:
    """Name the Python of an existing workspace that neither the projects of `sources` nor the working folder hold.

    Then execute the predicates of the workspace, or, before there is one, of these projects. `find` gives what needs
    consent: a plane that executes no leaf asks for predicates alone.

    Raises DefinitionError `UNTRUSTED_PYTHON` unless it `is_trusted`; `LEADS_OUT`; as `load_predicates`.
    """
    library, workspace = open_library(*sources), Workspace.open(root) if (root / MARKER).is_file() else None
    found = find(workspace, library) if workspace is not None else ()
    if found and not is_trusted:
        expected = "a skill as in this project, in an installed package or as shipped"
        hint = "Read it; --trust-python lets it run."
        asked = [Problem("UNTRUSTED_PYTHON", str(path), "other Python", expected, hint) for path in found]
        raise DefinitionError(asked)
    for path in found:
        announce(f"trusted Python: {path}")
    load_predicates((workspace.library() if workspace is not None else library).iter_predicates())
