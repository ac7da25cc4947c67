"""`export bt-xml` and `import`: behaviour trees to and from Groot2 and whatever else reads BehaviorTree.CPP 4."""

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
import yaml

from phyagentos.cli.arguments import RunPython, open_library
from phyagentos.cli.outcome import print_result
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.capabilities.trees import Tree, load_tree, parse_tree, read_tree
from phyagentos.protocol.documents.schema import Located

if TYPE_CHECKING:
    from phyagentos.export.bt_xml import NodeModel
    from phyagentos.runtime.execution.leaf_registry import LeafRegistry


def export_bt_xml(
    tree: Annotated[str, typer.Argument(help="Name of a tree or of a skill, or the YAML file of a tree.")],
    run_python: RunPython = False,
) -> None:
    """Print a behaviour tree and its subtrees as XML of BehaviorTree.CPP 4, with a model of every leaf."""
    from phyagentos.export.bt_xml import render_trees
    from phyagentos.runtime.execution.tree_check import read_sound_trees

    library = open_library(Path(tree))
    registry = _open_registry(library, runs_python=run_python)
    trees = read_sound_trees(find_tree(tree, library), library, registry)
    print_result(render_trees(list(trees.values()), dict(iter_leaf_models(registry))))


def import_tree(
    file: Annotated[Path, typer.Argument(metavar="TREE.xml", help="A file of BehaviorTree.CPP 4.")],
    to: Annotated[
        Path | None, typer.Option("--to", metavar="DIR", help="A project: writes DIR/trees/NAME.yaml of each new tree.")
    ] = None,
    run_python: RunPython = False,
) -> None:
    """Read behaviour trees of BehaviorTree.CPP 4; print the main one as YAML, or write each that is new."""
    from phyagentos.export.bt_xml_reader import read_trees

    library = Library.open(*([to] if to is not None else []), Path.cwd())
    registry = _open_registry(library, runs_python=run_python)
    read, problems = read_trees(file)
    trees, found = _check(read, library, registry)
    if problems or found:
        raise DefinitionError((*problems, *found))
    if to is None:
        print_result(_render(trees[0]))
        return
    new = {to / "trees" / f"{each.header.tree}.yaml": each for each in trees if not _is_known(each, library)}
    if there := [path for path in new if path.exists()]:
        raise DefinitionError.of("WOULD_OVERWRITE", str(there[0]), "another tree", "a name that is free")
    for path, each in new.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_render(each), encoding="utf-8")
    print_result("\n".join(map(str, new)) or "every tree of the file is in the library already")


def find_tree(argument: str, library: Library) -> str:
    """The name of the tree that is meant; raises `UNKNOWN_TREE` with the names that would have been found."""
    if Path(argument).suffix in {".yaml", ".yml"}:
        return read_tree(Path(argument)).header.tree
    trees, skills = library.names_of_trees(), library.names_of_skills()
    if argument not in trees and argument in skills and (found := read_skill(library.get_skill(argument))[0].tree):
        return found
    if argument not in trees:
        raise DefinitionError.unknown("UNKNOWN_TREE", "paos export bt-xml", argument, {*trees, *skills})
    return argument


def _open_registry(library: Library, *, runs_python: bool) -> "LeafRegistry":
    from phyagentos.runtime.execution.leaf_registry import build_registry, read_registry

    return (build_registry if runs_python else read_registry)(library)


def iter_leaf_models(registry: "LeafRegistry") -> Iterator[tuple[str, "NodeModel"]]:
    """What a TreeNodesModel says of every leaf that is known; a question that ends at once is a condition."""
    from phyagentos.export.bt_xml import NodeModel, Port
    from phyagentos.runtime.execution.leaf import Leaf, Role
    from phyagentos.runtime.execution.tree_check import PORT_TYPES

    types = {kind: name for name, kind in PORT_TYPES.items()}  # of several for texts the last, `string`
    for name in registry.names():
        leaf = registry.find(name)
        if leaf is None:  # only announced, by a file that was not executed
            continue
        asks = leaf.ROLE in (Role.VERIFY, Role.DECIDE) and leaf.on_running is Leaf.on_running and not leaf.OUTPUT_PORTS
        ports = {
            port: Port(
                way, types.get(each.data_type, ""), each.default_value if each.has_default else None, each.description
            )
            for way, group in (("input_port", leaf.INPUT_PORTS), ("output_port", leaf.OUTPUT_PORTS))
            for port, each in group.items()
        }
        optional = tuple(port for port, each in leaf.INPUT_PORTS.items() if not each.required)
        summary = (leaf.__doc__ or "").partition("\n")[0]
        yield name, NodeModel("Condition" if asks else "Action", ports, summary, optional)


def _check(read: Sequence[Located], library: Library, registry: "LeafRegistry") -> tuple[list[Tree], list[Problem]]:
    """The trees of a file, and what `paos lint` would find; what they name may be in the file or in the library."""
    from phyagentos.runtime.execution.tree_check import check_loaded_tree

    parsed = [parse_tree(located) for located in read]
    trees = [tree for tree, _ in parsed if tree is not None]
    problems = [problem for _, found in parsed for problem in found]
    with tempfile.TemporaryDirectory() as folder:
        for tree in trees:
            path = Path(folder, "trees", f"{tree.header.tree}.yaml")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(_render(tree), encoding="utf-8")
        seen = Library((Path(folder), *library.roots))
        return trees, problems + [each for tree in trees for each in check_loaded_tree(tree, seen, registry)]


def _is_known(tree: Tree, library: Library) -> bool:
    """Whether the library has it, whatever its comments and spaces."""
    from phyagentos.export.bt_xml import describe_tree

    if tree.header.tree not in library.names_of_trees():
        return False
    known, _ = load_tree(library.get_tree(tree.header.tree))
    return known is not None and (known.root, describe_tree(known.header)) == (tree.root, describe_tree(tree.header))


def _render(tree: Tree) -> str:
    return yaml.safe_dump(tree.located.data, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
