"""What there is: names that can be used here, statecharts, error codes."""

from enum import StrEnum
from pathlib import Path

import msgspec

from phyagentos.codes import CODES, Code, Retry, find_code
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.predicates.library import get_predicate_library
from phyagentos.protocol.predicates.project_predicates import load_predicates
from phyagentos.protocol.sessions import lifecycle
from phyagentos.protocol.sessions.statechart import Row

RETRIES = {
    Retry.NEVER: "the same will happen",
    Retry.EDITED: "once something was edited",
    Retry.LATER: "once machine or target are well",
    Retry.REPLANNED: "as a child session",
    Retry.OBSERVED: "only after a fresh observation",
    Retry.ELSEWHERE: "on another host, which observes its own world first",
}


class Listing(StrEnum):
    """What can be listed."""

    GRAPHS = "graphs"
    LEAVES = "leaves"
    PREDICATES = "predicates"
    SCENES = "scenes"
    SKILLS = "skills"
    TARGETS = "targets"
    TREES = "trees"


class Names(msgspec.Struct, frozen=True, kw_only=True):
    """Names of one kind; of a predicate, its form."""

    kind: Listing
    names: tuple[str, ...]


class Statechart(msgspec.Struct, frozen=True, kw_only=True):
    """The table that is also the code, and its picture."""

    transitions: tuple[Row, ...]
    mermaid: str


def list_names(kind: Listing, *, runs_python: bool = False) -> Names:
    """The names that can be used here; `behaviours.py` of skills are executed only where it `runs_python`."""
    library = Library.open(Path.cwd())
    match kind:
        case Listing.LEAVES:
            from phyagentos.runtime.execution.leaf_registry import build_registry, read_registry

            names = (build_registry(library) if runs_python else read_registry(library)).names()
        case Listing.PREDICATES:
            if runs_python:
                load_predicates(library.iter_predicates())
            names = [definition.signature for definition in get_predicate_library()]
        case Listing.GRAPHS:
            names = library.names_of_goal_graphs()
        case _:
            names = getattr(library, f"names_of_{kind}")()
    return Names(kind=kind, names=tuple(names))


def show_lifecycle(*, of_target: bool = False) -> Statechart:
    """The statechart of a session, or the phases of a target."""
    if of_target:
        from phyagentos.runtime.supervision.target_phase import PHASE_TRANSITIONS, render_phases

        rows, mermaid = PHASE_TRANSITIONS, render_phases()
    else:
        rows, mermaid = lifecycle.SESSION_TRANSITIONS, lifecycle.render_mermaid()
    return Statechart(transitions=rows, mermaid=mermaid)


def explain_codes(name: str = "") -> tuple[Code, ...]:
    """One error code, also by its name of an earlier release, or every one; DefinitionError `UNKNOWN_NAME`."""
    if not name:
        return tuple(CODES.values())
    if (code := find_code(name.upper())) is None:
        raise DefinitionError.unknown("error code", "paos codes", name.upper(), CODES)
    return (code,)
