"""Where trees, skills, scenes, robots, goal graphs and pristine documents are found; the first hit wins.

Search order: the folder of the user's project, libraries of installed packages (entry point group
`phyagentos.libraries`, functions that return a folder), then what ships with this package.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

from phyagentos.errors import DefinitionError
from phyagentos.plugins import Plugins
from phyagentos.protocol.documents.enclosure import leads_out

LIBRARIES = Plugins[Callable[[], str | Path]]("phyagentos.libraries")
BEHAVIOURS = "behaviours.py"  # a skill folder's own leaves: `def register(registry)`


@cache
def find_shipped_root() -> Path:
    """The folder that ships: `share/` in an installed wheel, the checkout's root in development."""
    package = Path(__file__).resolve().parents[2]
    share = package / "share"
    return share if share.is_dir() else package.parent


@dataclass(frozen=True, slots=True)
class Library:
    """Ordered roots, each with any of trees/, skills/, predicates/, scenes/, robots/, goal_graphs/, protocol/."""

    roots: tuple[Path, ...]

    @classmethod
    def open(cls, *projects: Path) -> "Library":
        """The library as seen from the given project folders."""
        announced = [Path(find_root()) for find_root in LIBRARIES.load_all().values()]
        roots: list[Path] = []
        for root in (*projects, *announced, find_shipped_root()):
            resolved = root.resolve()
            if resolved not in roots and resolved.is_dir():
                roots.append(resolved)
        return cls(tuple(roots))

    def get_tree(self, name: str) -> Path:
        """Path of `trees/<name>.yaml`; raises DefinitionError with the nearest name."""
        return self._get("tree", name, f"trees/{name}.yaml", self.names_of_trees)

    def has_tree(self, name: str) -> bool:
        """Whether there is `trees/<name>.yaml`; cheaper than to list them all."""
        return self._find(name, f"trees/{name}.yaml") is not None

    def get_skill(self, name: str) -> Path:
        """Path of `skills/<name>/SKILL.md`."""
        return self._get("skill", name, f"skills/{name}/SKILL.md", self.names_of_skills)

    def get_scene(self, name: str) -> Path:
        """Path of `scenes/<name>.yaml`."""
        return self._get("scene", name, f"scenes/{name}.yaml", self.names_of_scenes)

    def get_target(self, name: str) -> Path:
        """Path of `robots/<name>/target.yaml`."""
        return self._get("target", name, f"robots/{name}/target.yaml", self.names_of_targets)

    def iter_behaviours(self) -> Iterator[Path]:
        """The Python of skills, by skill."""
        paths = (self.get_skill(name).with_name(BEHAVIOURS) for name in self.names_of_skills())
        return (path for path in paths if path.is_file())

    def iter_predicates(self) -> Iterator[Path]:
        """The Python of predicates, by name of the file; the first root that has one wins."""
        found = {path.name: path for _, path in reversed(list(self._iter("predicates", "*.py")))}
        return (found[name] for name in sorted(found))

    def names_of_trees(self) -> list[str]:
        """Every tree, sorted."""
        return self._names_below("trees")

    def names_of_skills(self) -> list[str]:
        """Every skill, sorted."""
        return sorted({path.parent.name for _, path in self._iter("skills", "*/SKILL.md")})

    def names_of_scenes(self) -> list[str]:
        """Every scene, sorted."""
        return self._names_below("scenes")

    def names_of_targets(self) -> list[str]:
        """Every target, sorted."""
        return sorted({path.parent.name for _, path in self._iter("robots", "*/target.yaml")})

    def names_of_goal_graphs(self) -> list[str]:
        """Every goal graph, sorted."""
        return sorted({path.stem for _, path in self._iter("goal_graphs", "*.yaml")})

    def _names_below(self, folder: str) -> list[str]:
        found = self._iter(folder, "**/*.yaml")
        return sorted({path.relative_to(root / folder).with_suffix("").as_posix() for root, path in found})

    def _iter(self, folder: str, pattern: str) -> Iterator[tuple[Path, Path]]:
        return ((root, path) for root in self.roots for path in (root / folder).glob(pattern))

    def _find(self, name: str, relative: str) -> Path | None:
        places = _list_places(self.roots, relative) if not leads_out(name) else ()
        return next((path for path in places if os.path.isfile(path)), None)  # noqa: PTH113 - several times a session

    def _get(self, kind: str, name: str, relative: str, list_names: Callable[[], list[str]]) -> Path:
        if (path := self._find(name, relative)) is not None:
            return path
        raise DefinitionError.unknown(kind, ", ".join(map(str, self.roots)), name, list_names())


@lru_cache(maxsize=1024)
def _list_places(roots: tuple[Path, ...], relative: str) -> tuple[Path, ...]:
    """Where a file of the library may be, in the order of search."""
    return tuple(root / relative for root in roots)
