"""Make a project of one's own: a goal graph, a scene and a skill that run at once, and extensions with their tests."""

import shutil
from collections.abc import Iterable, Iterator, Sequence
from enum import StrEnum
from pathlib import Path

import msgspec

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.documents.durable_files import require_empty

TEMPLATES = Path(__file__).with_name("scaffold")
EXTENSIONS = Path(__file__).with_name("scaffold_extensions")
_TEMPLATE = ".tmpl"  # of Python: it is no module of this package
_LITTER = ("__pycache__",)


class Extension(StrEnum):
    """What a project can begin with, beside goals."""

    LEAF = "leaf"
    """A skill whose tree uses a leaf of its own."""
    PREDICATE = "predicate"
    """A predicate for criteria."""
    POLICY = "policy"
    """A policy server, and the skill that it carries out."""
    DRIVER = "driver"
    """A package with a driver of a body."""
    ROS2 = "ros2"
    """A robot of ROS 2: profile, settings of its kit, and notes on its launch."""


class NewProject(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos init --json` prints; `graph` is the one to run first, `tests` the folder of tests, if there is one."""

    folder: str
    files: tuple[str, ...]
    graph: str
    tests: str = ""


def init(folder: Path, extensions: Sequence[Extension] = ()) -> NewProject:
    """Write a project into a folder that is missing or empty, or extensions into a project that stands there.

    Raises DefinitionError `WOULD_OVERWRITE`.
    """
    graph = folder / "goal_graphs" / "first.yaml"
    sources = [EXTENSIONS / each for each in dict.fromkeys(extensions)]
    if not (extensions and graph.is_file()):
        require_empty(folder)
        sources.insert(0, TEMPLATES)
    written = _copy(sources, folder)
    tests = str(folder / "tests") if extensions else ""
    return NewProject(folder=str(folder), files=tuple(sorted(map(str, written))), graph=str(graph), tests=tests)


def _copy(sources: Iterable[Path], folder: Path) -> list[Path]:
    pairs = [pair for source in sources for pair in _iter_pairs(source, folder)]
    if there := [path for _, path in pairs if path.exists()]:
        expected = "files that are not there yet"
        raise DefinitionError([Problem("WOULD_OVERWRITE", str(path), "a file", expected) for path in there])
    for template, path in pairs:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(template, path)
    return [path for _, path in pairs]


def _iter_pairs(source: Path, folder: Path) -> Iterator[tuple[Path, Path]]:
    for template in sorted(path for path in source.rglob("*") if path.is_file()):
        parts = template.relative_to(source).parts
        if not any(part.startswith(".") or part in _LITTER for part in parts):
            yield template, folder.joinpath(*parts[:-1], parts[-1].removesuffix(_TEMPLATE))
