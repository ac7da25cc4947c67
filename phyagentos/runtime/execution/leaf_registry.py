"""The explicit registry of leaves; importing a module registers nothing.

Leaves come from this package, from installed packages (entry point group `phyagentos.leaves`: a subclass of `Leaf`, or
a function that takes the registry) and from a skill folder's own `behaviours.py`. Such a file is executed by
`build_registry` alone, for workers; who only reads a project takes the names of its leaves from the text.
"""

import ast
import operator
from collections.abc import Callable, Iterable
from pathlib import Path

from phyagentos.errors import DefinitionError, blaming
from phyagentos.plugins import Plugins, read_source, run_file
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import Tree
from phyagentos.runtime.execution.leaf import Leaf
from phyagentos.runtime.execution.leaves.builtin import BUILTIN


class LeafRegistry:
    """Leaf classes by the name that trees use."""

    def __init__(self) -> None:
        self._classes: dict[str, type[Leaf]] = {}
        self._announced: set[str] = set()
        self._sound: dict[tuple[Library, str], tuple[Tree, ...]] = {}

    def register(self, name: str, leaf: type[Leaf]) -> None:
        """Add a leaf.

        Raises:
            DefinitionError: `DUPLICATE_NAME` when another class has the name; `BROKEN_PYTHON`.
        """
        given: object = leaf
        if not (isinstance(given, type) and issubclass(given, Leaf)):
            raise DefinitionError.of("BROKEN_PYTHON", str(name), repr(leaf), "a subclass of phyagentos.skills.Leaf")
        existing = self._classes.get(name)
        if existing is not None and existing is not leaf:
            raise DefinitionError.of(
                "DUPLICATE_NAME",
                f"{leaf.__module__}.{leaf.__qualname__}",
                found=f"{name!r}, already {existing.__module__}.{existing.__qualname__}",
                hint="Rename one of them.",
            )
        self._classes[name] = leaf
        self._sound.clear()

    def announce(self, names: Iterable[str]) -> None:
        """Note leaves that a file would register, whose ports are unknown before it is executed."""
        self._announced |= set(names)

    def is_announced(self, name: str) -> bool:
        """Whether there is such a leaf and its class was not loaded."""
        return name in self._announced and name not in self._classes

    def is_sound(self, library: Library, name: str, trees: tuple[Tree, ...]) -> bool:
        """Whether a tree and its subtrees were already checked against these leaves."""
        known = self._sound.get((library, name), ())
        return len(known) == len(trees) > 0 and all(map(operator.is_, known, trees))

    def note_sound(self, library: Library, name: str, trees: tuple[Tree, ...]) -> None:
        """A tree and its subtrees fit these leaves; forgotten when a leaf is added."""
        self._sound[library, name] = trees

    def names(self) -> list[str]:
        """Every leaf, sorted."""
        return sorted(self._announced | self._classes.keys())

    def find(self, name: str) -> type[Leaf] | None:
        """The class of a leaf, or None."""
        return self._classes.get(name)

    def get(self, name: str) -> type[Leaf]:
        """The class of a leaf; raises DefinitionError `UNKNOWN_NAME`, with the nearest name."""
        leaf = self._classes.get(name)
        if leaf is None:
            raise DefinitionError.unknown("leaf", "leaf registry", name, self._classes)
        return leaf


LEAVES = Plugins[type[Leaf] | Callable[[LeafRegistry], None]]("phyagentos.leaves", BUILTIN)


def build_registry(library: Library) -> LeafRegistry:
    """Built-in leaves, then those of installed packages, then those of the library's skills, whose Python is executed.

    Raises:
        DefinitionError: `BROKEN_PYTHON`, `DUPLICATE_NAME`.
    """
    registry = _build_installed()
    for path in library.iter_behaviours():
        register_file(registry, path)
    return registry


def read_registry(library: Library) -> LeafRegistry:
    """As `build_registry`, but of the library's skills only the names of leaves, as written; executes none of them.

    Raises:
        DefinitionError: `BROKEN_PYTHON` where a file is no Python.
    """
    registry = _build_installed()
    for path in library.iter_behaviours():
        registry.announce(read_leaf_names(path))
    return registry


def read_leaf_names(path: Path) -> list[str]:
    """The names in calls `registry.register("name", …)` of a file; raises DefinitionError `BROKEN_PYTHON`."""
    return [
        node.args[0].value
        for node in ast.walk(read_source(path))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "register"
        if node.args and isinstance(node.args[0], ast.Constant) and isinstance(node.args[0].value, str)
    ]


def _build_installed() -> LeafRegistry:
    """Leaves of this package and of installed ones."""
    registry = LeafRegistry()
    for name, found in LEAVES.load_all().items():
        if isinstance(found, type):
            registry.register(name, found)
        else:
            with blaming(f"{name} of {LEAVES.group}", found):
                found(registry)
    return registry


def register_file(registry: LeafRegistry, path: Path) -> None:
    """Load a skill's `behaviours.py` and register its leaves.

    Raises:
        DefinitionError: `BROKEN_PYTHON` when the file cannot be loaded or has no `register`.
    """
    register = run_file(path).get("register")
    if not callable(register):
        raise DefinitionError.of("BROKEN_PYTHON", str(path), "no such function", "a function register(registry)")
    with blaming("register", register):
        register(registry)
