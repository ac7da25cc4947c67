"""`paos tree show`: a behaviour tree in the terminal, as Mermaid, as SVG, from its file and declared ports alone."""

from pathlib import Path
from typing import Annotated

import rich.markup
import typer
from rich.tree import Tree as Printed

from phyagentos.assembly.project import find_project
from phyagentos.cli.console import CleanConsole
from phyagentos.cli.outcome import print_note, print_result
from phyagentos.pictures.trees import Drawing, draw_tree, render_mermaid, render_svg
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import read_tree

PIPE_WIDTH = 400  # characters: a pipe cuts nothing
STYLES = {"leaf": "cyan", "subtree": "magenta", "control": "bold"}


def show(
    tree: Annotated[str, typer.Argument(help="Name of a tree, or its YAML file.")],
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a Mermaid flowchart.")] = False,
    svg: Annotated[Path | None, typer.Option(help="Write a drawing to this file.")] = None,
) -> None:
    """Draw a behaviour tree, subtrees included."""
    path = Path(tree)
    is_file = path.suffix in {".yaml", ".yml"}
    library = Library.open(find_project(path), Path.cwd()) if is_file else Library.open(Path.cwd())
    root = draw_tree(read_tree(path if is_file else library.get_tree(tree)), library)
    if svg is not None:
        svg.write_text(render_svg(root), encoding="utf-8")
        print_note(f"wrote {svg}")
    elif mermaid:
        print_result(render_mermaid(root))
    else:
        console = CleanConsole(highlight=False)
        console.width = console.width if console.is_terminal else PIPE_WIDTH
        console.print(_grow(root))


def _grow(node: Drawing) -> Printed:
    """For the terminal, in colours where it has them."""
    ports = f"  [dim]{rich.markup.escape(', '.join(node.ports))}[/]" if node.ports else ""
    printed = Printed(f"[{STYLES[node.family]}]{rich.markup.escape(node.label)}[/]{ports}")
    printed.children += map(_grow, node.children)
    return printed
