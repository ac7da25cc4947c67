"""Commands that show what there is: `list`, `schema`, `lifecycle`, `tree show`."""

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.assembly.project import find_project
from phyagentos.cli.arguments import RunPython
from phyagentos.cli.outcome import print_note, print_result
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.lifecycle import SESSION_TRANSITIONS, render_mermaid
from phyagentos.protocol.world.predicates.library import get_predicate_library

if TYPE_CHECKING:
    from phyagentos.pictures.trees import Drawing

_PIPE_WIDTH = 400  # characters: a pipe cuts nothing


class Listing(StrEnum):
    """What `paos list` lists."""

    GRAPHS = "graphs"
    LEAVES = "leaves"
    PREDICATES = "predicates"
    SCENES = "scenes"
    SKILLS = "skills"
    TARGETS = "targets"
    TREES = "trees"


def list_names(kind: Listing, run_python: RunPython = False) -> None:
    """Print the names that can be used here, one a line."""
    for name in _find_names(kind, runs_python=run_python):
        print_result(name)


def show_schema(
    kind: Annotated[str | None, typer.Argument(help="goal_graph, tree, skill, scene, target, sessions, …")] = None,
    fields: Annotated[bool, typer.Option("--fields", help="As a Markdown table of its fields.")] = False,
) -> None:
    """Print the JSON Schema of an authored file or a document; without a kind, the kinds."""
    from phyagentos.cli import field_tables, schemas

    if kind is None:
        print_result("\n".join(schemas.names_of_schemas()))
    elif fields:
        print_result(field_tables.render_fields(kind))
    else:
        print_result(schemas.render_schema(kind))


def show_lifecycle(
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a Mermaid statechart.")] = False,
    target: Annotated[bool, typer.Option("--target", help="The phases of a target instead.")] = False,
) -> None:
    """Print the statechart of a session, or of a target: the table that is also the code."""
    from phyagentos.runtime.supervision.target_phase import PHASE_TRANSITIONS, render_phases

    if mermaid:
        print_result(render_phases() if target else render_mermaid())
        return
    for row in PHASE_TRANSITIONS if target else SESSION_TRANSITIONS:
        condition = f"by {', '.join(row.by)}" if row.by else f"when {row.when}" if row.when else ""
        print_result(f"{row.trigger:<15} {', '.join(row.sources)} -> {row.dest}   {condition}".rstrip())


def show_tree(
    tree: Annotated[str, typer.Argument(help="Name of a tree, or its YAML file.")],
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a Mermaid flowchart.")] = False,
    svg: Annotated[Path | None, typer.Option(help="Write a drawing to this file.")] = None,
) -> None:
    """Draw a behaviour tree, subtrees included."""
    from phyagentos.pictures import trees
    from phyagentos.protocol.capabilities.trees import read_tree

    path = Path(tree)
    is_file = path.suffix in {".yaml", ".yml"}
    library = Library.open(find_project(path), Path.cwd()) if is_file else Library.open(Path.cwd())
    root = trees.draw_tree(read_tree(path if is_file else library.get_tree(tree)), library)
    if svg is not None:
        svg.write_text(trees.render_svg(root), encoding="utf-8")
        print_note(f"wrote {svg}")
    elif mermaid:
        print_result(trees.render_mermaid(root))
    else:
        _print_tree(root)


def _print_tree(root: "Drawing") -> None:
    """With rich, colours where the terminal has them."""
    from rich.markup import escape
    from rich.tree import Tree

    from phyagentos.cli.console import CleanConsole

    styles = {"leaf": "cyan", "subtree": "magenta", "control": "bold"}

    def show(node: "Drawing") -> str:
        ports = f"  [dim]{escape(', '.join(node.ports))}[/]" if node.ports else ""
        return f"[{styles[node.family]}]{escape(node.label)}[/]{ports}"

    def grow(branch: Tree, node: "Drawing") -> None:
        for child in node.children:
            grow(branch.add(show(child)), child)

    tree = Tree(show(root))
    grow(tree, root)
    console = CleanConsole(highlight=False)
    if not console.is_terminal:
        console.width = _PIPE_WIDTH
    console.print(tree)


def _find_names(kind: Listing, *, runs_python: bool) -> list[str]:
    library = Library.open(Path.cwd())
    if kind is Listing.LEAVES:
        from phyagentos.runtime.execution.leaf_registry import build_registry, read_registry

        return (build_registry(library) if runs_python else read_registry(library)).names()
    listed: dict[Listing, Callable[[], list[str]]] = {
        Listing.GRAPHS: library.names_of_goal_graphs,
        Listing.PREDICATES: lambda: [definition.signature for definition in get_predicate_library()],
        Listing.SCENES: library.names_of_scenes,
        Listing.SKILLS: library.names_of_skills,
        Listing.TARGETS: library.names_of_targets,
        Listing.TREES: library.names_of_trees,
    }
    return listed[kind]()
