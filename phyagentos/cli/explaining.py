"""Commands about sessions that ran: `why`, `rerun`."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.cli.outcome import Exit, ExitCode, print_note, print_result
from phyagentos.errors import format_hint, format_names
from phyagentos.protocol.sessions.session import SessionId

Id = Annotated[str, typer.Argument(metavar="SESSION", help="A session id; the part after the goal is enough.")]
Space = Annotated[Path, typer.Option("--workspace", "-w", help="Folder of the run.")]


def register(app: typer.Typer) -> None:
    """Add this group's commands."""
    app.command("why")(why)
    app.command("rerun")(rerun)


def why(session: Id, workspace: Space) -> None:
    """Explain a verdict: the layer, the leaf and the number that decided it."""
    from phyagentos.cli.history import read_ledger
    from phyagentos.cli.why import explain_session
    from phyagentos.protocol.workspace.workspace import Workspace

    ledger = read_ledger(workspace, session)
    print_result(explain_session(Workspace.open(workspace), ledger, get_session(session, ledger.sessions)))


def rerun(session: Id, workspace: Space) -> int:
    """Run a session once more from its own documents and compare the bits of the terminal state."""
    from phyagentos.assembly.rerun import rerun_session
    from phyagentos.cli.history import read_ledger

    id = get_session(session, read_ledger(workspace, session).sessions)
    repetition = rerun_session(workspace, id)
    if repetition.differences:
        print_result("\n".join([f"{id} came out differently:", *repetition.differences]))
    else:
        print_result(f"{id}: identical, bit for bit ({repetition.execution.ticks} commands)")
    print_note(f"second bundle in {repetition.workspace}")
    return int(ExitCode.GOAL_NOT_MET if repetition.differences else ExitCode.GOAL_MET)


def get_session(text: str, known: Iterable[SessionId]) -> SessionId:
    """The full id that a person means: the id itself, or the only one that ends with `.<text>`."""
    ids = list(known)
    found = [id for id in ids if id == text or id.split(".", 1)[-1] == text]
    if len(found) == 1:
        return found[0]
    short = [id.split(".", 1)[-1] for id in ids]
    problem = "several sessions are called that" if found else "no such session"
    hint = format_hint(text, [*ids, *short])
    raise Exit(ExitCode.INVALID_INPUT, f"{text}: {problem}; expected {format_names(found or ids)}. {hint}".rstrip())
