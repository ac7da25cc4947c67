"""Behaviour trees drawn, and exchanged with Groot2 and whatever else reads BehaviorTree.CPP 4."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import yaml

from phyagentos.assembly.project import find_project, open_library
from phyagentos.errors import DefinitionError, Problem
from phyagentos.pictures.trees import Drawing, draw_tree, render_mermaid, render_svg
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.capabilities.trees import Tree, parse_tree, read_tree
from phyagentos.protocol.documents.schema import Located
from phyagentos.scratch import open_scratch

if TYPE_CHECKING:
    from phyagentos.export.bt_xml import NodeModel
    from phyagentos.export.groot2_tree import LiveTree
    from phyagentos.runtime.execution.leaf_registry import LeafRegistry


class DrawnTree(msgspec.Struct, frozen=True, kw_only=True):
    """A behaviour tree, subtrees included, as nodes, as a Mermaid flowchart and as SVG."""

    root: Drawing
    mermaid: str
    svg: str


class ExportedTree(msgspec.Struct, frozen=True, kw_only=True):
    """A behaviour tree and its subtrees as XML of BehaviorTree.CPP 4, with a model of every leaf."""

    tree: str
    xml: str


class ImportedTrees(msgspec.Struct, frozen=True, kw_only=True):
    """The files that were written; none where every tree was in the library already."""

    files: tuple[Path, ...]


def draw(tree: str) -> DrawnTree:
    """Draw a tree, by its name or its YAML file, from declared ports alone; raises DefinitionError `UNKNOWN_NAME`."""
    path = Path(tree)
    is_file = _is_file(tree)
    library = Library.open(find_project(path), Path.cwd()) if is_file else Library.open(Path.cwd())
    root = draw_tree(read_tree(path if is_file else library.get_tree(tree)), library)
    return DrawnTree(root=root, mermaid=render_mermaid(root), svg=render_svg(root))


def export_bt_xml(tree: str, *, runs_python: bool = False) -> ExportedTree:
    """Write a tree, meant by its name, by that of a skill, or by its YAML file, as XML.

    `behaviours.py` of skills are executed only where it `runs_python`. Raises DefinitionError of the trees.
    """
    from phyagentos.export.bt_xml import render_trees
    from phyagentos.runtime.execution.tree_check import read_sound_trees

    library = open_library(Path(tree))
    registry, name = _open_registry(library, runs_python=runs_python), find_tree(tree, library)
    trees = read_sound_trees(name, library, registry)
    return ExportedTree(tree=name, xml=render_trees(list(trees.values()), dict(iter_leaf_models(registry))))


def read_live_tree(tree: str, library: Library) -> "LiveTree":
    """A tree as Groot2 follows it; the Python of skills is not run. Raises DefinitionError of the trees."""
    from phyagentos.export.groot2_tree import make_live_tree
    from phyagentos.runtime.execution.tree_check import read_sound_trees

    registry = _open_registry(library, runs_python=False)
    return make_live_tree(read_sound_trees(tree, library, registry), dict(iter_leaf_models(registry)))


def import_trees(file: Path, to: Path, *, runs_python: bool = False) -> ImportedTrees:
    """Write the trees of a file that Groot2 saved into `trees/` of the project `to`, as YAML.

    Raises DefinitionError with every problem that `paos lint` would find; `WOULD_OVERWRITE`.
    """
    from phyagentos.export.bt_xml_reader import read_trees

    library = Library.open(to, Path.cwd())
    registry = _open_registry(library, runs_python=runs_python)
    read, problems = read_trees(file, registry.names())
    trees, found = _check(read, library, registry)
    if problems or found:
        raise DefinitionError(_arrange([*problems, *found]))
    known = {name: read_tree(library.get_tree(name)) for name in library.names_of_trees() if name in trees}
    changed = [tree for name, tree in trees.items() if name not in known or not _are_equal(tree, known[name])]
    new = {to / "trees" / f"{tree.header.tree}.yaml": tree.located.data for tree in changed}
    if there := [path for path in new if path.exists()]:
        raise DefinitionError.of("WOULD_OVERWRITE", str(there[0]), "another tree", "a name that is free")
    _write(new)
    return ImportedTrees(files=tuple(new))


_BEYOND = {  # kind of name: what to do where none of the possible ones is meant
    "leaf": "Write what none of them does in the behaviours.py of a skill.",
    "tree": "A tree of another file: import that file first.",
}


def _arrange(problems: list[Problem]) -> list[Problem]:
    """In the order of the file; what is possible for a kind of name is listed once."""
    listed: set[str] = set()
    arranged: list[Problem] = []
    for each in sorted(problems, key=lambda each: [int(step) for step in each.address.split(":") if step.isdigit()]):
        is_known = each.code == "UNKNOWN_NAME" and each.expected in listed
        listed.add(each.expected)
        arranged.append(
            msgspec.structs.replace(
                each,
                expected=f"a {each.kind} as above" if is_known else each.expected,
                hint=each.hint if is_known else f"{each.hint} {_BEYOND.get(each.kind, '')}".strip(),
            )
        )
    return arranged


def find_tree(argument: str, library: Library) -> str:
    """The name of the tree that is meant by its name, by its file, or by a skill that it carries out."""
    if _is_file(argument):
        return read_tree(Path(argument)).header.tree
    if argument not in library.names_of_trees() and argument in library.names_of_skills():
        return read_skill(library.get_skill(argument))[0].tree
    return argument


def _is_file(argument: str) -> bool:
    return Path(argument).suffix in {".yaml", ".yml"}


def _open_registry(library: Library, *, runs_python: bool) -> "LeafRegistry":
    from phyagentos.runtime.execution.leaf_registry import build_registry, read_registry

    return (build_registry if runs_python else read_registry)(library)


def iter_leaf_models(registry: "LeafRegistry") -> Iterator[tuple[str, "NodeModel"]]:
    """What a TreeNodesModel says of every leaf that is known; a question that ends at once is a condition."""
    from phyagentos.export.bt_xml import NodeModel, Port
    from phyagentos.runtime.execution.leaf import Leaf, Role
    from phyagentos.runtime.execution.port_types import PORT_TYPES

    types = {kind: name for name, kind in PORT_TYPES.items()}  # of several for texts the last, `string`
    leaves = {name: leaf for name in registry.names() if (leaf := registry.find(name))}  # not those that are announced
    for name, leaf in leaves.items():
        asks = leaf.ROLE in (Role.VERIFY, Role.DECIDE) and leaf.on_running is Leaf.on_running and not leaf.OUTPUT_PORTS
        ports = {
            port: Port(
                way, types.get(each.data_type, ""), each.default_value if each.has_default else None, each.description
            )
            for way, group in (("input_port", leaf.INPUT_PORTS), ("output_port", leaf.OUTPUT_PORTS))
            for port, each in group.items()
        }
        yield name, NodeModel("Condition" if asks else "Action", ports, (leaf.__doc__ or "").partition("\n")[0])


def _are_equal(a: Tree, b: Tree) -> bool:
    """Whether two trees say the same, however their files do."""
    ports = [(tree.header.description, tree.header.inputs, tree.header.outputs) for tree in (a, b)]
    return a.root == b.root and ports[0] == ports[1]


def _check(
    read: Sequence[Located], library: Library, registry: "LeafRegistry"
) -> tuple[dict[str, Tree], list[Problem]]:
    """The trees of a file, and what `paos lint` would find; each may name others of the file."""
    from phyagentos.runtime.execution.tree_check import check_loaded_tree

    parsed = [parse_tree(located) for located in read]
    problems = [problem for _, found in parsed for problem in found]
    trees = {tree.header.tree: tree for tree, _ in parsed if tree is not None}
    with open_scratch() as folder:
        _write({Path(folder, "trees", f"{name}.yaml"): tree.located.data for name, tree in trees.items()})
        seen = Library((folder, *library.roots))
        return trees, problems + [each for tree in trees.values() for each in check_loaded_tree(tree, seen, registry)]


def _write(files: Mapping[Path, Any]) -> None:
    for path, data in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
        path.write_text(text, encoding="utf-8")
