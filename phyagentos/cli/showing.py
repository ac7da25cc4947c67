"""Commands that show what there is: `list`, `describe`, `schema`, `lifecycle`, `codes`, `tree show | serve`."""

from collections.abc import Iterator
from pathlib import Path
from signal import SIGINT, SIGTERM, signal
from threading import Event
from typing import Annotated

import rich.markup
import typer
from rich.console import Group, RenderableType
from rich.text import Text
from rich.tree import Tree as Printed

from phyagentos.cli import schemas
from phyagentos.cli.arguments import RunPython, choose_newest
from phyagentos.cli.console import build_table
from phyagentos.cli.outcome import print_result
from phyagentos.cli.reply import Reply
from phyagentos.cli.schemas import ShownSchema
from phyagentos.codes import ALIASES, Code
from phyagentos.operations import behaviour_trees, listing
from phyagentos.operations import describe as declarations
from phyagentos.operations.behaviour_trees import DrawnTree
from phyagentos.operations.describe import KINDS, Described
from phyagentos.operations.groot2 import PORT, serve_groot2
from phyagentos.operations.listing import RETRIES, Listing, Names, Statechart
from phyagentos.pictures.trees import Drawing

_STYLES = {"leaf": "cyan", "subtree": "magenta", "control": "bold"}


def list_names(kind: Listing, run_python: RunPython = False) -> Reply[Names]:
    """Print the names that can be used here, one a line."""
    found = listing.list_names(kind, runs_python=run_python)
    return Reply(found, "\n".join(found.names))


def describe(
    kind: Annotated[str, typer.Argument(metavar="NAME|KIND", help=f"What, or one of {', '.join(KINDS)}.")] = "",
    name: Annotated[str, typer.Argument(help="Which of the kind, or a field of it; all, a line each, without.")] = "",
) -> Reply[tuple[Described, ...]]:
    """Describe a leaf, skill, predicate, fault or setting by its own declaration."""
    if name or kind in KINDS or not kind:
        found = declarations.describe(kind, name)
    else:
        found = declarations.describe_name(name := kind)
    if not name:
        return Reply(found, build_table(("", ""), ((each.name, _plain(each.summary)) for each in found)))
    return Reply(found, Group(*(part for each in found for part in _render_declaration(each))))


def show_schema(
    kind: Annotated[str, typer.Argument(help="goal_graph, tree, skill, scene, target, sessions, …")] = "",
    fields: Annotated[bool, typer.Option("--fields", help="As a Markdown table of its fields.")] = False,
) -> Reply[ShownSchema]:
    """Print the JSON Schema of an authored file, a document or a result; without a kind, the kinds."""
    found = schemas.show(kind)
    if not kind:
        return Reply(found, "\n".join(found.kinds))
    return Reply(found, schemas.render_fields(kind) if fields else schemas.render_schema(kind), folds=False)


def show_lifecycle(
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a Mermaid statechart.")] = False,
    target: Annotated[bool, typer.Option("--target", help="The phases of a target instead.")] = False,
) -> Reply[Statechart]:
    """Print the statechart of a session, or of a target: the table that is also the code."""
    found, lines = listing.show_lifecycle(of_target=target), []
    for row in found.transitions:
        condition = f"by {', '.join(row.by)}" if row.by else f"when {row.when}" if row.when else ""
        lines.append(f"{row.trigger:<15} {', '.join(row.sources)} -> {row.dest}   {condition}".rstrip())
    return Reply(found, found.mermaid if mermaid else "\n".join(lines), folds=not mermaid)


def show_codes(
    name: Annotated[str, typer.Argument(help="One code; without it, all.")] = "",
) -> Reply[tuple[Code, ...]]:
    """Explain an error code: phase, meaning, who acts, whether trying again can help."""
    found = listing.explain_codes(name)
    acts = ((each, f"{each.phase}; {each.actor} acts; again: {RETRIES[each.retry]}") for each in found)
    renamed = ALIASES.get(name.upper())
    notes = [f"{name.upper()} is called {renamed} now"] if renamed else []
    return Reply(found, "\n".join(f"{code.name}: {code.meaning} ({facts})" for code, facts in acts), notes)


def show(
    tree: Annotated[str, typer.Argument(help="Name of a tree, or its YAML file.")],
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a Mermaid flowchart.")] = False,
    svg: Annotated[Path | None, typer.Option(help="Write a drawing to this file.")] = None,
) -> Reply[DrawnTree]:
    """Draw a behaviour tree, subtrees included."""
    found = behaviour_trees.draw(tree)
    if svg is not None:
        svg.write_text(found.svg, encoding="utf-8")
        return Reply(found, notes=[f"wrote {svg}"])
    return Reply(found, found.mermaid if mermaid else _grow(found.root), folds=not mermaid)


def serve(
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help="Its folder; else the newest.")] = None,
    port: Annotated[int, typer.Option(help="Of this machine; 0 for a free one.", min=0, max=65535)] = PORT,
) -> None:
    """Show the tree of the running session in Groot2, live, until Ctrl-C."""
    ends = Event()
    for number in (SIGINT, SIGTERM):
        signal(number, lambda *_: ends.set())
    serve_groot2(workspace or choose_newest(), ends, print_result, port=port)


def _render_declaration(each: Described) -> Iterator[RenderableType]:
    """Its exact name first, then what it is, in short facts and a table of what it takes."""
    yield Text.assemble((each.name, "bold"), f"  {each.kind}")
    yield Text(_plain(each.summary))
    facts = [row for row in each.rows if not (row.takes or row.default or row.meaning)]
    yield build_table(("", ""), ((row.part, row.name) for row in facts))
    rows = [row for row in each.rows if row not in facts]
    if rows:
        columns = ("name", "part", "takes", "default", "meaning")
        yield build_table(columns, ([_plain(getattr(row, column)) for column in columns] for row in rows))
    yield Text()


def _plain(text: str) -> str:
    """Without the marks of Markdown, which the pages of the same declarations have."""
    return text.replace("`", "")


def _grow(node: Drawing) -> Printed:
    """For the terminal, in colours where it has them."""
    ports = f"  [dim]{rich.markup.escape(', '.join(node.ports))}[/]" if node.ports else ""
    printed = Printed(f"[{_STYLES[node.family]}]{rich.markup.escape(node.label)}[/]{ports}")
    printed.children += map(_grow, node.children)
    return printed
