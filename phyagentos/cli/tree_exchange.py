"""`export bt-xml` and `import`: behaviour trees to and from Groot2 and whatever else reads BehaviorTree.CPP 4."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

from phyagentos.assembly.project import open_library
from phyagentos.cli.arguments import RunPython
from phyagentos.cli.outcome import print_result
from phyagentos.errors import DefinitionError, Problem
from phyagentos.export.bt_xml import NodeModel, Port, render_trees
from phyagentos.export.bt_xml_reader import read_trees
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.capabilities.trees import parse_tree, read_tree
from phyagentos.protocol.documents.schema import Located

if TYPE_CHECKING:
    from phyagentos.runtime.execution.leaf_registry import LeafRegistry


def bt_xml(
    tree: Annotated[str, typer.Argument(help="Name of a tree or of a skill, or the YAML file of a tree.")],
    run_python: RunPython = False,
) -> None:
    """Print a behaviour tree and its subtrees as XML of BehaviorTree.CPP 4, with a model of every leaf."""
    from phyagentos.runtime.execution.tree_check import read_sound_trees

    library = open_library(Path(tree))
    registry = _open_registry(library, runs_python=run_python)
    trees = read_sound_trees(find_tree(tree, library), library, registry)
    print_result(render_trees(list(trees.values()), dict(iter_leaf_models(registry))))


def import_tree(
    file: Annotated[Path, typer.Argument(metavar="TREE.xml", help="A file of BehaviorTree.CPP 4.")],
    to: Annotated[Path, typer.Option("--to", metavar="DIR", help="A project: its trees/ gets what is new.")] = Path(),
    run_python: RunPython = False,
) -> None:
    """Write the behaviour trees of a file that Groot2 saved as YAML."""
    library = Library.open(to, Path.cwd())
    read, problems = read_trees(file)
    trees, found = _check(read, library, _open_registry(library, runs_python=run_python))
    if problems or found:
        raise DefinitionError((*problems, *found))
    known = {name: read_tree(library.get_tree(name)).located.data for name in library.names_of_trees() if name in trees}
    new = {to / "trees" / f"{name}.yaml": data for name, data in trees.items() if data != known.get(name)}
    if there := [path for path in new if path.exists()]:
        raise DefinitionError.of("WOULD_OVERWRITE", str(there[0]), "another tree", "a name that is free")
    _write(new)
    print_result("\n".join(map(str, new)) or "every tree of the file is in the library already")


def find_tree(argument: str, library: Library) -> str:
    """The name of the tree that is meant by its name, by its file, or by a skill that it carries out."""
    if Path(argument).suffix in {".yaml", ".yml"}:
        return read_tree(Path(argument)).header.tree
    if argument not in library.names_of_trees() and argument in library.names_of_skills():
        return read_skill(library.get_skill(argument))[0].tree
    return argument


def _open_registry(library: Library, *, runs_python: bool) -> "LeafRegistry":
    from phyagentos.runtime.execution.leaf_registry import build_registry, read_registry

    return (build_registry if runs_python else read_registry)(library)


def iter_leaf_models(registry: "LeafRegistry") -> Iterator[tuple[str, NodeModel]]:
    """What a TreeNodesModel says of every leaf that is known; a question that ends at once is a condition."""
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


def _check(read: Sequence[Located], library: Library, registry: "LeafRegistry") -> tuple[dict[str, Any], list[Problem]]:
    """Data of the trees of a file, and what `paos lint` would find; each may name others of the file."""
    from phyagentos.runtime.execution.tree_check import check_loaded_tree

    parsed = [parse_tree(located) for located in read]
    problems = [problem for _, found in parsed for problem in found]
    trees = {tree.header.tree: tree for tree, _ in parsed if tree is not None}
    data = {name: tree.located.data for name, tree in trees.items()}
    with tempfile.TemporaryDirectory() as folder:
        _write({Path(folder, "trees", f"{name}.yaml"): each for name, each in data.items()})
        seen = Library((Path(folder), *library.roots))
        return data, problems + [each for tree in trees.values() for each in check_loaded_tree(tree, seen, registry)]


def _write(files: Mapping[Path, Any]) -> None:
    for path, data in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
        path.write_text(text, encoding="utf-8")
