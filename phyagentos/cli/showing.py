"""Commands that show what there is: `list`, `schema`, `lifecycle`, `codes`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.arguments import RunPython
from phyagentos.cli.outcome import print_result
from phyagentos.codes import CODES, Retry
from phyagentos.errors import DefinitionError, format_hint
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.predicates.library import get_predicate_library
from phyagentos.protocol.sessions.lifecycle import SESSION_TRANSITIONS, render_mermaid

RETRIES = {
    Retry.NEVER: "the same will happen",
    Retry.EDITED: "once something was edited",
    Retry.LATER: "once machine or target are well",
    Retry.REPLANNED: "as a child session",
    Retry.OBSERVED: "only after a fresh observation",
}


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
    from phyagentos.cli import schemas

    if kind is None:
        print_result("\n".join(schemas.names_of_schemas()))
    elif fields:
        print_result(schemas.render_fields(kind))
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


def show_codes(
    name: Annotated[str | None, typer.Argument(help="One code; without it, all.")] = None,
) -> None:
    """Explain an error code: phase, meaning, who acts, whether trying again can help."""
    if name is not None and name.upper() not in CODES:
        expected, hint = "a code of `paos codes`", format_hint(name.upper(), CODES)
        raise DefinitionError.of("UNKNOWN_CODE", "paos codes", repr(name), expected, hint)
    for code in CODES.values() if name is None else (CODES[name.upper()],):
        print_result(f"{code.name}: {code.meaning} ({code.phase}; {code.actor} acts; again: {RETRIES[code.retry]})")


def _find_names(kind: Listing, *, runs_python: bool) -> list[str]:
    library = Library.open(Path.cwd())
    match kind:
        case Listing.LEAVES:
            from phyagentos.runtime.execution.leaf_registry import build_registry, read_registry

            return (build_registry(library) if runs_python else read_registry(library)).names()
        case Listing.PREDICATES:
            return [definition.signature for definition in get_predicate_library()]
        case Listing.GRAPHS:
            return library.names_of_goal_graphs()
        case _:
            names: list[str] = getattr(library, f"names_of_{kind}")()
            return names
