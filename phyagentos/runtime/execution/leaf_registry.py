"""The explicit registry of leaves; importing a module registers nothing.

Leaves come from this package, from installed packages (entry point group `phyagentos.leaves`: a function that takes
the registry) and from a skill folder's own `behaviours.py`.
"""

import importlib.util
import operator
from importlib.metadata import entry_points
from pathlib import Path

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import Tree
from phyagentos.runtime.execution.leaf import Leaf, Role

ENTRY_POINT_GROUP = "phyagentos.leaves"
BEHAVIOURS = "behaviours.py"  # a skill folder's own leaves: `def register(registry)`


class LeafRegistry:
    """Leaf classes by the name that trees use."""

    def __init__(self) -> None:
        self._classes: dict[str, type[Leaf]] = {}
        self._sound: dict[tuple[Library, str], tuple[Tree, ...]] = {}

    def register(self, name: str, leaf: type[Leaf]) -> None:
        """Add a leaf.

        Raises:
            DefinitionError: `DUPLICATE_LEAF` when another class has the name; `NOT_A_LEAF` without a declared role.
        """
        if not all((issubclass(leaf, Leaf), isinstance(getattr(leaf, "ROLE", None), Role))):
            expected = "a subclass of execution.leaf.Leaf that declares its ROLE"
            raise DefinitionError.of("NOT_A_LEAF", name, repr(leaf), expected)
        existing = self._classes.get(name)
        if existing is not None and existing is not leaf:
            found = f"{name!r}, already {existing.__module__}.{existing.__qualname__}"
            hint = "Rename one of them."
            raise DefinitionError.of("DUPLICATE_LEAF", f"{leaf.__module__}.{leaf.__qualname__}", found, hint=hint)
        self._classes[name] = leaf
        self._sound.clear()

    def is_sound(self, library: Library, name: str, trees: tuple[Tree, ...]) -> bool:
        """Whether a tree and its subtrees were already checked against these leaves."""
        known = self._sound.get((library, name), ())
        return len(known) == len(trees) > 0 and all(map(operator.is_, known, trees))

    def note_sound(self, library: Library, name: str, trees: tuple[Tree, ...]) -> None:
        """A tree and its subtrees fit these leaves; forgotten when a leaf is added."""
        self._sound[library, name] = trees

    def names(self) -> list[str]:
        """Every leaf, sorted."""
        return sorted(self._classes)

    def find(self, name: str) -> type[Leaf] | None:
        """The class of a leaf, or None."""
        return self._classes.get(name)

    def get(self, name: str) -> type[Leaf]:
        """The class of a leaf; raises DefinitionError `UNKNOWN_LEAF`, with the nearest name."""
        leaf = self._classes.get(name)
        if leaf is None:
            raise DefinitionError.unknown("UNKNOWN_LEAF", "leaf registry", name, self._classes)
        return leaf


def build_registry(library: Library) -> LeafRegistry:
    """Built-in leaves, then those of installed packages, then those of the library's skills."""
    from phyagentos.runtime.execution.leaves.builtin import register_builtin

    registry = LeafRegistry()
    register_builtin(registry)
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
        point.load()(registry)
    for skill in library.names_of_skills():
        path = library.get_skill(skill).with_name(BEHAVIOURS)
        if path.is_file():
            register_file(registry, path)
    return registry


def register_file(registry: LeafRegistry, path: Path) -> None:
    """Load a skill's `behaviours.py` and register its leaves.

    Raises:
        DefinitionError: `BROKEN_BEHAVIOURS` when the file cannot be loaded or has no `register`.
    """
    spec = importlib.util.spec_from_file_location(f"phyagentos_skill_{path.parent.name}", path)
    if spec is None or spec.loader is None:
        raise DefinitionError.of("BROKEN_BEHAVIOURS", str(path), "not a Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        register = module.register
    except DefinitionError:
        raise
    except Exception as error:
        raise DefinitionError.of(
            "BROKEN_BEHAVIOURS", str(path), f"{type(error).__name__}: {error}", "a function register(registry)"
        ) from error
    register(registry)
