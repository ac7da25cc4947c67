"""One loader for every kind of plug-in: what ships, and what installed packages announce as entry points, by name.

    SCORERS = Plugins[Scorer]("phyagentos.scorers", {"outcomes": OUTCOMES}, kind=Scorer)
    SCORERS.names()            # ['mine', 'outcomes'], sorted; nothing is imported
    SCORERS.load("mine")       # imported now

A name has one owner: where two packages announce it, or one announces a name that ships, `DUPLICATE_NAME` says which.
What does not load is `BROKEN_PYTHON` for those that name it, and for nothing else. Python in the folder of a project is
no plug-in: `run_file` executes it, once its user has consented.
"""

import ast
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from phyagentos.errors import DefinitionError, blaming, get_known, list_foreign_errors

T = TypeVar("T")
PACKAGE = "phyagentos"


@dataclass(frozen=True)
class Plugins(Generic[T]):
    """The plug-ins of an entry point group.

    Attributes:
        group: `phyagentos.judges`.
        shipped: What this package brings, by name; a text `module:object` is imported when it is loaded.
        kind: What each must be an instance of; None for any object.
        noun: What one of them is called where a name is unknown.
    """

    group: str
    shipped: Mapping[str, T | str] = field(default_factory=dict)
    kind: type[T] | None = None
    noun: str = "plug-in"

    def names(self) -> list[str]:
        """Every name, sorted; nothing is imported. Raises DefinitionError `DUPLICATE_NAME`."""
        return sorted(self._find_points())

    def find(self, name: str, address: str = "") -> T | EntryPoint:
        """The plug-in of a name; what a package or a text names is not imported. Raises as `load`."""
        return get_known(self.noun, address or self.group, name, self._find_points())

    def load(self, name: str, address: str = "") -> T:
        """The plug-in of a name.

        Raises:
            DefinitionError: `UNKNOWN_NAME` at `address`, with the nearest name; `DUPLICATE_NAME`;
                `BROKEN_PYTHON` with the package and what it raised.
        """
        point = self.find(name, address)
        loaded = point if not isinstance(point, EntryPoint) else self._import(point)
        if self.kind is not None and not isinstance(loaded, self.kind):
            raise self._refuse(point, f"a {type(loaded).__name__}", f"a {self.kind.__name__}")
        if isinstance(own := getattr(loaded, "name", name), str) and own != name:
            raise self._refuse(point, f"is called {own!r}", f"the name {name!r}")
        return loaded

    def load_all(self) -> dict[str, T]:
        """All by name, sorted; raises as `load`."""
        return {name: self.load(name) for name in self.names()}

    def _find_points(self) -> dict[str, T | EntryPoint]:
        points: dict[str, T | EntryPoint] = {
            str(name): EntryPoint(name, each, self.group) if isinstance(each, str) else each
            for name, each in self.shipped.items()
        }
        for point in _find_announced(self.group, tuple(sys.path)):
            if (other := points.get(point.name)) is not None:
                found = f"{point.name!r} of {_name_package(other)} and of {_name_package(point)}"
                hint = "Uninstall one of them, or let its author rename it."
                raise DefinitionError.of("DUPLICATE_NAME", self.group, found, "one package for each name", hint)
            points[point.name] = point
        return points

    def _import(self, point: EntryPoint) -> T:
        try:
            return cast("T", point.load())
        except DefinitionError:
            raise
        except list_foreign_errors() as error:
            raise self._refuse(point, f"raised {type(error).__name__}: {error}", "a module that loads") from error

    def _refuse(self, point: T | EntryPoint, found: str, expected: str) -> DefinitionError:
        named = f"{point.name!r} ({point.value}) " if isinstance(point, EntryPoint) else ""
        text = f"{named}of {_name_package(point)} {found}"
        return DefinitionError.of("BROKEN_PYTHON", self.group, text, expected, "Repair or uninstall the package.")


def import_object(reference: str, noun: str, address: str) -> object:
    """The object that a text `module:object` names; raises DefinitionError `UNKNOWN_NAME` for one of this kind."""
    try:
        return EntryPoint(reference, reference, "").load()
    except (ImportError, AttributeError) as error:
        expected = "an object that can be imported from the working folder"
        raise DefinitionError.of("UNKNOWN_NAME", address, f"{reference!r}: {error}", expected, kind=noun) from error


def run_file(path: Path) -> dict[str, Any]:
    """The names that a Python file of a project defines, which is executed; never a cached `.pyc` beside it.

    Raises DefinitionError `BROKEN_PYTHON`.
    """
    names: dict[str, Any] = {"__name__": f"phyagentos_project_{path.parent.name}_{path.stem}", "__file__": str(path)}
    with blaming("loading it", path):
        exec(compile(path.read_bytes(), path, "exec"), names)
    return names


def read_source(path: Path) -> ast.Module:
    """The syntax tree of a Python file, which is not executed; raises DefinitionError `BROKEN_PYTHON`."""
    try:
        return ast.parse(path.read_bytes())
    except (SyntaxError, ValueError, RecursionError, MemoryError, OSError) as error:
        address = f"{path}:{getattr(error, 'lineno', None) or 1}:{getattr(error, 'offset', None) or 1}"
        raise DefinitionError.of("BROKEN_PYTHON", address, f"{type(error).__name__}: {error}", "Python") from error


@lru_cache(maxsize=64)
def _find_announced(group: str, _path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """The entry points of a group, by name; found once for each path of Python."""
    return tuple(sorted(entry_points(group=group), key=lambda point: (point.name, point.value)))


def _name_package(point: object) -> str:
    dist = point.dist if isinstance(point, EntryPoint) else None
    return f"package {dist.name}" if dist is not None else f"package {PACKAGE}"
